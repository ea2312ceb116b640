/*
 * Who may join a farm. `pathfarm keygen` writes one key and one self-signed certificate per role:
 *
 *     master.key master.crt   worker.key worker.crt   user.key user.crt   trusted/
 *
 * A certificate says its role (URI "pathfarm:role:worker"); it is trusted because the very same
 * certificate (SHA-256 of its DER) lies in the directory: as ROLE.crt, or as any *.crt in trusted/,
 * where a farm with a key per worker keeps theirs. A master trusts workers and users, those trust
 * masters. A worker's host needs worker.key, worker.crt and master.crt.
 *
 * Private keys have mode 0600 and are refused when others may read them.
 *
 * Thread: load and generate anywhere; a struct keys is read-only afterwards and may be shared.
 */
#ifndef PROTO_KEYS_H
#define PROTO_KEYS_H

#include "proto/digest.h"
#include "proto/role.h"

#include <stdbool.h>

struct err;
struct ssl_st; /* OpenSSL's SSL */

/* Make all six files in `dir` (made, 0700, when missing). Files that exist are an error unless
 * `overwrite`; nothing is written then. */
bool keys_generate(const char *dir, bool overwrite, struct err *err);

/* An identity, and whom it trusts. NULL with ERR_AUTH when anything is missing or unsafe. */
struct keys;
struct keys *keys_load(const char *dir, enum role role, struct err *err);
void keys_free(struct keys *keys); /* NULL is fine; channels made from it may live on */

enum role keys_role(const struct keys *keys);
const char *keys_role_name(enum role role); /* "worker" */

/*
 * For proto/channel_tls.c: a TLS 1.3 session of this identity, that accepts only trusted peers
 * whose role is among `peers` (bits); NULL when memory runs out. The text of why a peer was not
 * trusted, and the role of one that was, are asked for afterwards.
 */
struct ssl_st *keys_session(const struct keys *keys, bool accepting, unsigned peers);
const char *keys_session_refusal(const struct ssl_st *session); /* "" when there was none */
enum role keys_session_peer(const struct ssl_st *session);      /* after the handshake */

#endif
