/*
 * Who is at an end of a connection. Bits, so that a table can name several.
 */
#ifndef PROTO_ROLE_H
#define PROTO_ROLE_H

enum role {
    ROLE_MASTER = 1,
    ROLE_WORKER = 2,
    ROLE_USER = 4, /* submits, watches and cancels jobs */
};

#endif
