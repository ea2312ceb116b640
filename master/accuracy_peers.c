#include "master/accuracy_peers.h"

#include "common/err.h"
#include "master/number.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* "name<between>core_seconds,relmse" in [text, end) */
static bool parse(const char *text, const char *end, char between, struct accuracy_peer *peer)
{
    const char *name_end = memchr(text, between, (size_t)(end - text));
    if (name_end == NULL || name_end == text)
        return false;
    const char *comma = memchr(name_end + 1, ',', (size_t)(end - name_end - 1));
    if (comma == NULL || !number_parse(name_end + 1, comma, &peer->core_s) ||
        !number_parse(comma + 1, end, &peer->relmse))
        return false;
    snprintf(peer->name, sizeof(peer->name), "%.*s", (int)(name_end - text), text);
    return isfinite(peer->core_s) && isfinite(peer->relmse) && peer->core_s > 0 && peer->relmse > 0;
}

static bool append(struct accuracy_peers *peers, const struct accuracy_peer *peer, struct err *err)
{
    if (peers->count == ACCURACY_PEERS_MAX)
        return err_set(err, ERR_ARGUMENT, "more than %d points of other renderers",
                       ACCURACY_PEERS_MAX);
    peers->points[peers->count++] = *peer;
    return true;
}

bool accuracy_peers_add(struct accuracy_peers *peers, const char *text, struct err *err)
{
    struct accuracy_peer peer;
    if (!parse(text, text + strlen(text), '=', &peer))
        return err_set(err, ERR_ARGUMENT, "\"%s\" is not of the form NAME=core_seconds,relmse",
                       text);
    return append(peers, &peer, err);
}

bool accuracy_peers_read(struct accuracy_peers *peers, const char *path, struct err *err)
{
    FILE *file = fopen(path, "r");
    if (file == NULL)
        return err_set(err, ERR_ARGUMENT, "%s: %s", path, strerror(errno));
    char line[512];
    bool read = true;
    for (unsigned number = 1; read && fgets(line, sizeof(line), file) != NULL; number++) {
        struct accuracy_peer peer;
        size_t length = strcspn(line, "\r\n");
        if (length == 0)
            continue;
        if (parse(line, line + length, ',', &peer))
            read = append(peers, &peer, err);
        else if (number > 1)
            read = err_set(err, ERR_ARGUMENT, "%s:%u: not of the form NAME,core_seconds,relmse",
                           path, number);
    }
    fclose(file);
    return read;
}
