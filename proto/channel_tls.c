#include "proto/channel_tls.h"

#include "common/err.h"
#include "proto/keys.h"

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#define RECORD_SIZE 16384 /* plaintext of one TLS record, at most */

struct channel_tls {
    SSL *ssl;
    const struct channel_tls_sink *sink;
    void *owner;
    const unsigned char *in; /* what is left of the bytes being fed */
    size_t in_size;
    bool opened;
};

/*
 * The BIO between OpenSSL and us: reads take from the bytes being fed, writes go to the sink.
 */
static int bio_read(BIO *bio, char *to, size_t size, size_t *done)
{
    struct channel_tls *tls = BIO_get_data(bio);
    BIO_clear_retry_flags(bio);
    if (tls->in_size == 0) {
        BIO_set_retry_read(bio);
        return 0;
    }
    *done = size < tls->in_size ? size : tls->in_size;
    memcpy(to, tls->in, *done);
    tls->in += *done;
    tls->in_size -= *done;
    return 1;
}

static int bio_write(BIO *bio, const char *from, size_t size, size_t *done)
{
    struct channel_tls *tls = BIO_get_data(bio);
    BIO_clear_retry_flags(bio);
    if (!tls->sink->send(tls->owner, from, size))
        return 0;
    *done = size;
    return 1;
}

static long bio_control(BIO *bio, int command, long number, void *pointer)
{
    (void)bio;
    (void)number;
    (void)pointer;
    return command == BIO_CTRL_FLUSH; /* nothing is ever held back */
}

static int bio_create(BIO *bio)
{
    BIO_set_init(bio, 1);
    return 1;
}

static BIO_METHOD *bio_method;
static pthread_once_t bio_method_once = PTHREAD_ONCE_INIT;

static void make_bio_method(void)
{
    BIO_METHOD *method = BIO_meth_new(BIO_get_new_index() | BIO_TYPE_SOURCE_SINK, "channel");
    if (method == NULL)
        return;
    if (BIO_meth_set_read_ex(method, bio_read) == 1 &&
        BIO_meth_set_write_ex(method, bio_write) == 1 &&
        BIO_meth_set_ctrl(method, bio_control) == 1 && BIO_meth_set_create(method, bio_create) == 1)
        bio_method = method;
    else
        BIO_meth_free(method);
}

struct channel_tls *channel_tls_new(const struct keys *keys, bool accepting, unsigned peers,
                                    const struct channel_tls_sink *sink, void *owner)
{
    pthread_once(&bio_method_once, make_bio_method);
    struct channel_tls *tls = calloc(1, sizeof(*tls));
    if (tls == NULL || bio_method == NULL)
        goto fail;
    tls->sink = sink;
    tls->owner = owner;
    tls->ssl = keys_session(keys, accepting, peers);
    BIO *bio = tls->ssl != NULL ? BIO_new(bio_method) : NULL;
    if (bio == NULL)
        goto fail;
    BIO_set_data(bio, tls);
    SSL_set_bio(tls->ssl, bio, bio); /* the session owns it now, once */
    return tls;

fail:
    channel_tls_free(tls);
    ERR_clear_error();
    return NULL;
}

void channel_tls_free(struct channel_tls *tls)
{
    if (tls == NULL)
        return;
    SSL_free(tls->ssl);
    free(tls);
}

/* Did this call of OpenSSL fail for good? Then err says why. */
static bool failed(struct channel_tls *tls, int result, struct err *err)
{
    int kind = SSL_get_error(tls->ssl, result);
    if (kind == SSL_ERROR_NONE || kind == SSL_ERROR_WANT_READ || kind == SSL_ERROR_WANT_WRITE ||
        kind == SSL_ERROR_ZERO_RETURN)
        return false;
    const char *refusal = keys_session_refusal(tls->ssl);
    const char *reason = ERR_reason_error_string(ERR_peek_last_error());
    if (refusal[0] != '\0')
        err_set(err, ERR_AUTH, "%s", refusal);
    else
        err_set(err, tls->opened ? ERR_MESSAGE : ERR_AUTH, "TLS: %s",
                reason != NULL ? reason : "the session broke");
    ERR_clear_error();
    return true;
}

static bool shake_hands(struct channel_tls *tls, struct err *err)
{
    ERR_clear_error();
    int result = SSL_do_handshake(tls->ssl);
    return result == 1 || !failed(tls, result, err);
}

bool channel_tls_start(struct channel_tls *tls, struct err *err)
{
    return shake_hands(tls, err);
}

bool channel_tls_feed(struct channel_tls *tls, const void *bytes, size_t size, struct err *err)
{
    unsigned char plain[RECORD_SIZE];
    bool fine = true, wanted = true;
    tls->in = bytes;
    tls->in_size = size;

    if (!tls->opened) {
        fine = shake_hands(tls, err);
        if (!fine || !SSL_is_init_finished(tls->ssl))
            goto done;
        tls->opened = true;
        wanted = tls->sink->opened(tls->owner);
    }
    while (fine && wanted) {
        size_t part;
        ERR_clear_error();
        int result = SSL_read_ex(tls->ssl, plain, sizeof(plain), &part);
        if (result != 1) {
            fine = !failed(tls, result, err);
            break;
        }
        wanted = tls->sink->receive(tls->owner, plain, part);
    }

done:
    tls->in = NULL; /* lent to us for this call only */
    tls->in_size = 0;
    return fine;
}

bool channel_tls_write(struct channel_tls *tls, const void *bytes, size_t size, struct err *err)
{
    size_t done;
    if (size == 0)
        return true;
    ERR_clear_error();
    int result = SSL_write_ex(tls->ssl, bytes, size, &done);
    if (result == 1)
        return true;
    if (!failed(tls, result, err))
        err_set(err, ERR_MESSAGE, "TLS: the session cannot send");
    return false;
}

void channel_tls_shutdown(struct channel_tls *tls)
{
    if (tls->opened)
        SSL_shutdown(tls->ssl);
    ERR_clear_error(); /* it is over either way */
}

bool channel_tls_ended(const struct channel_tls *tls)
{
    return (SSL_get_shutdown(tls->ssl) & SSL_RECEIVED_SHUTDOWN) != 0;
}

enum role channel_tls_peer(const struct channel_tls *tls)
{
    return keys_session_peer(tls->ssl);
}
