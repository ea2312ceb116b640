# Goal: scenes whose radiance is known in closed form render to it, within four standard errors,
# through master, wire and worker; and scenes with a planted bug do not.
. "$(dirname "$0")/farm-lib.bash"
unset PATHFARM_WORKER_ARGS # real rays

python3 "$(dirname "$0")/closed_forms.py" || fail "closed forms"
