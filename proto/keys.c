#include "proto/keys.h"

#include "common/err.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define ROLE_URI      "pathfarm:role:"
#define FILE_SIZE_MAX 65536
#define PINS_MAX      100000
#define VALID_DAYS    3650
#define SKEW_SECONDS  (24 * 60 * 60) /* clocks on a farm differ; a key must work at once */

static const enum role roles[] = { ROLE_MASTER, ROLE_WORKER, ROLE_USER };
#define ROLE_COUNT (sizeof(roles) / sizeof(roles[0]))

/* A certificate that is trusted */
struct pin {
    struct digest digest;
    enum role role;
};

struct keys {
    atomic_uint holders; /* whoever loaded it, and every session */
    enum role role;
    SSL_CTX *context;
    struct pin *pins;
    size_t pin_count;
};

/* What a session remembers of its peer */
struct session {
    struct keys *keys;
    unsigned peers;
    enum role peer;
    char refusal[256];
};

const char *keys_role_name(enum role role)
{
    switch (role) {
    case ROLE_MASTER:
        return "master";
    case ROLE_WORKER:
        return "worker";
    case ROLE_USER:
        return "user";
    }
    return "nobody";
}

static const char *openssl_reason(void)
{
    const char *reason = ERR_reason_error_string(ERR_peek_last_error());
    ERR_clear_error();
    return reason != NULL ? reason : "no reason given";
}

/* Reading files */

/*
 * The whole file as a memory BIO. Modes with a bit of `forbidden` are refused: a private key that
 * others may read is not private, a certificate that others may write is not trusted.
 */
static BIO *read_file(int dir_fd, const char *dir, const char *name, mode_t forbidden,
                      struct err *err)
{
    char content[FILE_SIZE_MAX];
    struct stat stat;
    BIO *memory = NULL;
    int fd = openat(dir_fd, name, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) {
        err_set(err, ERR_AUTH, "%s/%s: %s", dir, name, strerror(errno));
        goto fail_open;
    }
    if (fstat(fd, &stat) != 0 || !S_ISREG(stat.st_mode)) {
        err_set(err, ERR_AUTH, "%s/%s: not a file", dir, name);
        goto fail_read;
    }
    if ((stat.st_mode & forbidden) != 0) {
        err_set(err, ERR_AUTH, "%s/%s: mode %03o lets others %s it; chmod %03o it", dir, name,
                stat.st_mode & 0777u, (stat.st_mode & forbidden & 044) != 0 ? "read" : "write",
                stat.st_mode & 0777u & ~forbidden);
        goto fail_read;
    }
    size_t size = 0;
    ssize_t part;
    while (size < sizeof(content) && (part = read(fd, content + size, sizeof(content) - size)) > 0)
        size += (size_t)part;
    if (size == 0 || size == sizeof(content)) {
        err_set(err, ERR_AUTH, "%s/%s: not a key or certificate", dir, name);
        goto fail_read;
    }
    memory = BIO_new(BIO_s_mem());
    if (memory == NULL || BIO_write(memory, content, (int)size) != (int)size) {
        BIO_free(memory);
        memory = NULL;
        err_set(err, ERR_MEMORY, "no memory for %s/%s", dir, name);
    }

fail_read:
    close(fd);
fail_open:
    OPENSSL_cleanse(content, sizeof(content));
    return memory;
}

static int no_password(char *text, int size, int writing, void *context)
{
    (void)text;
    (void)size;
    (void)writing;
    (void)context;
    return -1; /* OpenSSL would ask on the terminal otherwise */
}

static EVP_PKEY *read_key(int dir_fd, const char *dir, const char *name, struct err *err)
{
    BIO *memory = read_file(dir_fd, dir, name, 077, err);
    if (memory == NULL)
        return NULL;
    EVP_PKEY *key = PEM_read_bio_PrivateKey(memory, NULL, no_password, NULL);
    if (key == NULL)
        err_set(err, ERR_AUTH, "%s/%s: not a private key without a password: %s", dir, name,
                openssl_reason());
    BIO_free(memory);
    return key;
}

static X509 *read_certificate(int dir_fd, const char *dir, const char *name, struct err *err)
{
    BIO *memory = read_file(dir_fd, dir, name, 022, err);
    if (memory == NULL)
        return NULL;
    X509 *certificate = PEM_read_bio_X509(memory, NULL, no_password, NULL);
    if (certificate == NULL)
        err_set(err, ERR_AUTH, "%s/%s: not a certificate: %s", dir, name, openssl_reason());
    BIO_free(memory);
    return certificate;
}

/* What a certificate says */

static bool certificate_role(X509 *certificate, enum role *role)
{
    GENERAL_NAMES *names = X509_get_ext_d2i(certificate, NID_subject_alt_name, NULL, NULL);
    unsigned found = 0;
    for (int i = 0; names != NULL && i < sk_GENERAL_NAME_num(names); i++) {
        const GENERAL_NAME *name = sk_GENERAL_NAME_value(names, i);
        if (name->type != GEN_URI)
            continue;
        const ASN1_IA5STRING *uri = name->d.uniformResourceIdentifier;
        for (size_t r = 0; r < ROLE_COUNT; r++) {
            char expected[64];
            int length = snprintf(expected, sizeof(expected), ROLE_URI "%s",
                                  keys_role_name(roles[r]));
            if (ASN1_STRING_length(uri) == length &&
                memcmp(ASN1_STRING_get0_data(uri), expected, (size_t)length) == 0)
                found |= roles[r];
        }
    }
    GENERAL_NAMES_free(names);
    if (found == 0 || (found & (found - 1)) != 0) /* exactly one */
        return false;
    *role = (enum role)found;
    return true;
}

static bool certificate_expired(const X509 *certificate)
{
    return X509_cmp_current_time(X509_get0_notAfter(certificate)) <= 0;
}

static bool certificate_digest(const X509 *certificate, struct digest *digest)
{
    unsigned size = 0;
    return X509_digest(certificate, EVP_sha256(), digest->bytes, &size) == 1 && size == DIGEST_SIZE;
}

/* Trust */

static const struct pin *find_pin(const struct keys *keys, const struct digest *digest)
{
    for (size_t i = 0; i < keys->pin_count; i++)
        if (digest_equal(&keys->pins[i].digest, digest))
            return &keys->pins[i];
    return NULL;
}

static bool add_pin(struct keys *keys, X509 *certificate, const char *dir, const char *name,
                    unsigned wanted, struct err *err)
{
    struct pin pin;
    if (!certificate_role(certificate, &pin.role))
        return err_set(err, ERR_AUTH, "%s/%s: does not name one role of a farm", dir, name);
    if ((pin.role & wanted) == 0)
        return true;
    if (!certificate_digest(certificate, &pin.digest))
        return err_set(err, ERR_AUTH, "%s/%s: %s", dir, name, openssl_reason());
    if (find_pin(keys, &pin.digest) != NULL)
        return true;
    if (keys->pin_count == PINS_MAX)
        return err_set(err, ERR_LIMIT, "%s: more than %d certificates", dir, PINS_MAX);
    struct pin *pins = realloc(keys->pins, (keys->pin_count + 1) * sizeof(*pins));
    if (pins == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %s/%s", dir, name);
    keys->pins = pins;
    keys->pins[keys->pin_count++] = pin;
    return true;
}

static bool add_pin_file(struct keys *keys, int dir_fd, const char *dir, const char *name,
                         unsigned wanted, struct err *err)
{
    X509 *certificate = read_certificate(dir_fd, dir, name, err);
    if (certificate == NULL)
        return false;
    bool added = add_pin(keys, certificate, dir, name, wanted, err);
    X509_free(certificate);
    return added;
}

static bool safe_directory(int fd, const char *path, struct err *err)
{
    struct stat stat;
    if (fstat(fd, &stat) != 0)
        return err_set(err, ERR_AUTH, "%s: %s", path, strerror(errno));
    if ((stat.st_mode & 022) != 0)
        return err_set(err, ERR_AUTH, "%s: mode %03o lets others write into it; chmod %03o it",
                       path, stat.st_mode & 0777u, stat.st_mode & 0755u);
    return true;
}

static bool add_trusted(struct keys *keys, int dir_fd, const char *dir, unsigned wanted,
                        struct err *err)
{
    char path[4096];
    snprintf(path, sizeof(path), "%s/trusted", dir);
    int fd = openat(dir_fd, "trusted", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0 && errno == ENOENT)
        return true;
    if (fd < 0)
        return err_set(err, ERR_AUTH, "%s: %s", path, strerror(errno));
    bool added = safe_directory(fd, path, err);
    DIR *entries = added ? fdopendir(fd) : NULL;
    if (entries == NULL) {
        if (added)
            added = err_set(err, ERR_AUTH, "%s: %s", path, strerror(errno));
        close(fd);
        return added;
    }
    struct dirent *entry;
    while (added && (entry = readdir(entries)) != NULL) {
        size_t length = strlen(entry->d_name);
        if (length > 4 && strcmp(entry->d_name + length - 4, ".crt") == 0)
            added = add_pin_file(keys, fd, path, entry->d_name, wanted, err);
    }
    closedir(entries);
    return added;
}

static bool load_pins(struct keys *keys, int dir_fd, const char *dir, struct err *err)
{
    unsigned wanted = keys->role == ROLE_MASTER ? ROLE_WORKER | ROLE_USER : ROLE_MASTER;
    for (size_t r = 0; r < ROLE_COUNT; r++) {
        char name[32];
        snprintf(name, sizeof(name), "%s.crt", keys_role_name(roles[r]));
        bool absent = faccessat(dir_fd, name, F_OK, 0) != 0 && errno == ENOENT;
        if ((roles[r] & wanted) == 0 || absent)
            continue;
        if (!add_pin_file(keys, dir_fd, dir, name, roles[r], err))
            return false;
    }
    if (!add_trusted(keys, dir_fd, dir, wanted, err))
        return false;
    if (keys->pin_count == 0)
        return err_set(err, ERR_AUTH, "%s: no certificate of a %s to trust", dir,
                       keys->role == ROLE_MASTER ? "worker or user" : "master");
    return true;
}

/* Sessions */

static int session_index = -1;
static pthread_once_t session_index_once = PTHREAD_ONCE_INIT;

static void drop_keys(struct keys *keys)
{
    if (atomic_fetch_sub(&keys->holders, 1) != 1)
        return;
    SSL_CTX_free(keys->context);
    free(keys->pins);
    free(keys);
}

static void free_session(void *parent, void *value, CRYPTO_EX_DATA *data, int index, long number,
                         void *pointer)
{
    (void)parent;
    (void)data;
    (void)index;
    (void)number;
    (void)pointer;
    struct session *session = value;
    if (session == NULL)
        return;
    drop_keys(session->keys);
    free(session);
}

static void make_session_index(void)
{
    session_index = SSL_get_ex_new_index(0, NULL, NULL, NULL, free_session);
}

/* Replaces OpenSSL's chain building: trusted is what lies in the directory, nothing else. */
static int judge_peer(X509_STORE_CTX *store, void *unused)
{
    (void)unused;
    SSL *ssl = X509_STORE_CTX_get_ex_data(store, SSL_get_ex_data_X509_STORE_CTX_idx());
    struct session *session = SSL_get_ex_data(ssl, session_index);
    X509 *certificate = X509_STORE_CTX_get0_cert(store);
    struct digest digest;
    int verdict = X509_V_ERR_CERT_UNTRUSTED;

    const struct pin *pin = NULL;
    if (certificate != NULL && certificate_digest(certificate, &digest))
        pin = find_pin(session->keys, &digest);
    if (pin == NULL) {
        char hex[DIGEST_HEX_SIZE] = "";
        if (certificate != NULL)
            digest_hex(&digest, hex);
        snprintf(session->refusal, sizeof(session->refusal),
                 "its certificate (SHA-256 %s) is not one this farm trusts", hex);
    } else if ((pin->role & session->peers) == 0) {
        snprintf(session->refusal, sizeof(session->refusal),
                 "its certificate is a %s's, which has no business here",
                 keys_role_name(pin->role));
        verdict = X509_V_ERR_INVALID_PURPOSE;
    } else if (certificate_expired(certificate)) {
        snprintf(session->refusal, sizeof(session->refusal), "its certificate has expired");
        verdict = X509_V_ERR_CERT_HAS_EXPIRED;
    } else {
        session->peer = pin->role;
        verdict = X509_V_OK;
    }
    X509_STORE_CTX_set_error(store, verdict);
    return verdict == X509_V_OK;
}

static SSL_CTX *make_context(void)
{
    SSL_CTX *context = SSL_CTX_new(TLS_method());
    if (context == NULL)
        return NULL;
    SSL_CTX_set_options(context, SSL_OP_NO_TICKET | SSL_OP_NO_COMPRESSION |
                                     SSL_OP_NO_RENEGOTIATION | SSL_OP_CIPHER_SERVER_PREFERENCE);
    SSL_CTX_set_mode(context, SSL_MODE_RELEASE_BUFFERS);
    SSL_CTX_set_session_cache_mode(context, SSL_SESS_CACHE_OFF);
    SSL_CTX_set_max_cert_list(context, FILE_SIZE_MAX);
    SSL_CTX_set_verify(context, SSL_VERIFY_PEER | SSL_VERIFY_FAIL_IF_NO_PEER_CERT, NULL);
    SSL_CTX_set_cert_verify_callback(context, judge_peer, NULL);
    if (SSL_CTX_set_min_proto_version(context, TLS1_3_VERSION) == 1 &&
        SSL_CTX_set_max_proto_version(context, TLS1_3_VERSION) == 1 &&
        SSL_CTX_set_num_tickets(context, 0) == 1 && SSL_CTX_set_max_early_data(context, 0) == 1 &&
        SSL_CTX_set_recv_max_early_data(context, 0) == 1 &&
        SSL_CTX_set_ciphersuites(context, "TLS_AES_128_GCM_SHA256:TLS_AES_256_GCM_SHA384:"
                                          "TLS_CHACHA20_POLY1305_SHA256") == 1)
        return context;
    SSL_CTX_free(context);
    return NULL;
}

static bool load_identity(struct keys *keys, int dir_fd, const char *dir, struct err *err)
{
    char name[32];
    const char *role_name = keys_role_name(keys->role);
    enum role role;
    bool loaded = false;

    snprintf(name, sizeof(name), "%s.key", role_name);
    EVP_PKEY *key = read_key(dir_fd, dir, name, err);
    if (key == NULL)
        goto fail_key;
    snprintf(name, sizeof(name), "%s.crt", role_name);
    X509 *certificate = read_certificate(dir_fd, dir, name, err);
    if (certificate == NULL)
        goto fail_certificate;

    if (!certificate_role(certificate, &role) || role != keys->role)
        err_set(err, ERR_AUTH, "%s/%s: not the certificate of a %s", dir, name, role_name);
    else if (certificate_expired(certificate))
        err_set(err, ERR_AUTH, "%s/%s: has expired; make new keys with pathfarm keygen", dir, name);
    else if (X509_check_private_key(certificate, key) != 1)
        err_set(err, ERR_AUTH, "%s/%s: belongs to another key than %s.key", dir, name, role_name);
    else if (SSL_CTX_use_certificate(keys->context, certificate) != 1 ||
             SSL_CTX_use_PrivateKey(keys->context, key) != 1)
        err_set(err, ERR_AUTH, "%s/%s: cannot be used: %s", dir, name, openssl_reason());
    else
        loaded = true;
    ERR_clear_error();

    X509_free(certificate);
fail_certificate:
    EVP_PKEY_free(key);
fail_key:
    return loaded;
}

struct keys *keys_load(const char *dir, enum role role, struct err *err)
{
    struct keys *keys = NULL;
    int dir_fd = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (dir_fd < 0) {
        err_set(err, ERR_AUTH, "%s: %s; pathfarm keygen makes keys", dir, strerror(errno));
        goto fail_open;
    }
    pthread_once(&session_index_once, make_session_index);
    keys = calloc(1, sizeof(*keys));
    if (keys == NULL) {
        err_set(err, ERR_MEMORY, "no memory for keys");
        goto fail;
    }
    atomic_init(&keys->holders, 1);
    keys->role = role;
    keys->context = make_context();
    if (keys->context == NULL || session_index < 0) {
        err_set(err, ERR_AUTH, "TLS 1.3 is not available: %s", openssl_reason());
        goto fail;
    }
    if (!safe_directory(dir_fd, dir, err) || !load_identity(keys, dir_fd, dir, err) ||
        !load_pins(keys, dir_fd, dir, err))
        goto fail;
    close(dir_fd);
    return keys;

fail:
    keys_free(keys);
    close(dir_fd);
fail_open:
    err_wrap(err, "keys of the %s", keys_role_name(role));
    return NULL;
}

void keys_free(struct keys *keys)
{
    if (keys != NULL)
        drop_keys(keys);
}

enum role keys_role(const struct keys *keys)
{
    return keys->role;
}

struct ssl_st *keys_session(const struct keys *shared, bool accepting, unsigned peers)
{
    struct keys *keys = (struct keys *)shared; /* only its count of holders changes */
    struct session *session = calloc(1, sizeof(*session));
    SSL *ssl = SSL_new(keys->context);
    if (session == NULL || ssl == NULL || SSL_set_ex_data(ssl, session_index, session) != 1)
        goto fail;
    atomic_fetch_add(&keys->holders, 1);
    session->keys = keys;
    session->peers = peers;
    if (accepting)
        SSL_set_accept_state(ssl);
    else
        SSL_set_connect_state(ssl);
    return ssl;

fail:
    SSL_free(ssl);
    free(session);
    ERR_clear_error();
    return NULL;
}

const char *keys_session_refusal(const struct ssl_st *ssl)
{
    const struct session *session = SSL_get_ex_data(ssl, session_index);
    return session->refusal;
}

enum role keys_session_peer(const struct ssl_st *ssl)
{
    const struct session *session = SSL_get_ex_data(ssl, session_index);
    return session->peer;
}

/* Making keys */

static bool add_extension(X509 *certificate, int nid, const char *value)
{
    X509V3_CTX context;
    X509V3_set_ctx(&context, certificate, certificate, NULL, NULL, 0);
    X509_EXTENSION *extension = X509V3_EXT_conf_nid(NULL, &context, nid, value);
    bool added = extension != NULL && X509_add_ext(certificate, extension, -1) == 1;
    X509_EXTENSION_free(extension);
    return added;
}

static bool set_serial(X509 *certificate)
{
    unsigned char bytes[16];
    if (RAND_bytes(bytes, sizeof(bytes)) != 1)
        return false;
    bytes[0] &= 0x7f; /* positive */
    BIGNUM *number = BN_bin2bn(bytes, sizeof(bytes), NULL);
    bool set = number != NULL &&
               BN_to_ASN1_INTEGER(number, X509_get_serialNumber(certificate)) != NULL;
    BN_free(number);
    return set;
}

static X509 *make_certificate(EVP_PKEY *key, enum role role)
{
    char uri[64];
    snprintf(uri, sizeof(uri), "URI:" ROLE_URI "%s", keys_role_name(role));
    X509 *certificate = X509_new();
    if (certificate == NULL)
        return NULL;
    X509_NAME *name = X509_get_subject_name(certificate);
    const unsigned char *role_text = (const unsigned char *)keys_role_name(role);
    if (X509_set_version(certificate, X509_VERSION_3) == 1 && set_serial(certificate) &&
        X509_gmtime_adj(X509_getm_notBefore(certificate), -SKEW_SECONDS) != NULL &&
        X509_time_adj_ex(X509_getm_notAfter(certificate), VALID_DAYS, 0, NULL) != NULL &&
        X509_NAME_add_entry_by_txt(name, "CN", MBSTRING_ASC, (const unsigned char *)"pathfarm", -1,
                                   -1, 0) == 1 &&
        X509_NAME_add_entry_by_txt(name, "OU", MBSTRING_ASC, role_text, -1, -1, 0) == 1 &&
        X509_set_issuer_name(certificate, name) == 1 && X509_set_pubkey(certificate, key) == 1 &&
        add_extension(certificate, NID_basic_constraints, "critical,CA:FALSE") &&
        add_extension(certificate, NID_key_usage, "critical,digitalSignature") &&
        add_extension(certificate, NID_subject_alt_name, uri) &&
        X509_sign(certificate, key, EVP_sha256()) > 0)
        return certificate;
    X509_free(certificate);
    return NULL;
}

/* A file that is about to be written */
struct draft {
    char name[32];
    mode_t mode;
    BIO *content;
};
#define DRAFT_COUNT (2 * ROLE_COUNT)

static bool draft_role(struct draft *key_draft, struct draft *certificate_draft, enum role role,
                       struct err *err)
{
    EVP_PKEY *key = EVP_EC_gen("P-256");
    X509 *certificate = key != NULL ? make_certificate(key, role) : NULL;
    snprintf(key_draft->name, sizeof(key_draft->name), "%s.key", keys_role_name(role));
    snprintf(certificate_draft->name, sizeof(certificate_draft->name), "%s.crt",
             keys_role_name(role));
    key_draft->mode = 0600;
    certificate_draft->mode = 0644;
    key_draft->content = BIO_new(BIO_s_secmem());
    certificate_draft->content = BIO_new(BIO_s_mem());
    bool drafted = certificate != NULL && key_draft->content != NULL &&
                   certificate_draft->content != NULL &&
                   PEM_write_bio_PKCS8PrivateKey(key_draft->content, key, NULL, NULL, 0, NULL,
                                                 NULL) == 1 &&
                   PEM_write_bio_X509(certificate_draft->content, certificate) == 1;
    if (!drafted)
        err_set(err, ERR_AUTH, "making a key: %s", openssl_reason());
    X509_free(certificate);
    EVP_PKEY_free(key);
    return drafted;
}

static bool write_all(int fd, const char *bytes, size_t size)
{
    while (size > 0) {
        ssize_t part = write(fd, bytes, size);
        if (part < 0 && errno == EINTR)
            continue;
        if (part <= 0)
            return false;
        bytes += part;
        size -= (size_t)part;
    }
    return true;
}

/* Whole or not at all: a temporary file, synced, then linked (never over another) or renamed. */
static bool publish(int dir_fd, const char *dir, const struct draft *draft, bool overwrite,
                    struct err *err)
{
    char temporary[64];
    char *bytes;
    long size = BIO_get_mem_data(draft->content, &bytes);
    bool published = false;
    snprintf(temporary, sizeof(temporary), ".%.31s.%ld", draft->name, (long)getpid());
    int fd = openat(dir_fd, temporary, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC,
                    draft->mode);
    if (fd < 0)
        goto fail_open;
    /* fchmod: the umask must not decide */
    bool written = fchmod(fd, draft->mode) == 0 && write_all(fd, bytes, (size_t)size) &&
                   fsync(fd) == 0;
    if (close(fd) != 0 || !written)
        goto fail;
    published = overwrite ? renameat(dir_fd, temporary, dir_fd, draft->name) == 0
                          : linkat(dir_fd, temporary, dir_fd, draft->name, 0) == 0;

fail:
    if (!published)
        err_set(err, ERR_IO, "%s/%s: %s", dir, draft->name, strerror(errno));
    unlinkat(dir_fd, temporary, 0);
    return published;

fail_open:
    return err_set(err, ERR_IO, "%s/%s: %s", dir, draft->name, strerror(errno));
}

static bool publish_all(int dir_fd, const char *dir, const struct draft *drafts, bool overwrite,
                        struct err *err)
{
    size_t done = 0;
    for (size_t i = 0; i < DRAFT_COUNT && !overwrite; i++)
        if (faccessat(dir_fd, drafts[i].name, F_OK, AT_SYMLINK_NOFOLLOW) == 0)
            return err_set(err, ERR_ARGUMENT, "%s/%s exists and is not overwritten", dir,
                           drafts[i].name);
    while (done < DRAFT_COUNT && publish(dir_fd, dir, &drafts[done], overwrite, err))
        done++;
    if (done == DRAFT_COUNT)
        return fsync(dir_fd) == 0 || err_set(err, ERR_IO, "%s: %s", dir, strerror(errno));
    while (done > 0 && !overwrite)
        unlinkat(dir_fd, drafts[--done].name, 0);
    return false;
}

bool keys_generate(const char *dir, bool overwrite, struct err *err)
{
    struct draft drafts[DRAFT_COUNT] = { 0 };
    bool generated = false;
    if (mkdir(dir, 0700) != 0 && errno != EEXIST)
        return err_set(err, ERR_IO, "%s: %s", dir, strerror(errno));
    int dir_fd = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (dir_fd < 0)
        return err_set(err, ERR_IO, "%s: %s", dir, strerror(errno));
    if (!safe_directory(dir_fd, dir, err))
        goto fail;
    for (size_t r = 0; r < ROLE_COUNT; r++)
        if (!draft_role(&drafts[2 * r], &drafts[2 * r + 1], roles[r], err))
            goto fail;
    if (!publish_all(dir_fd, dir, drafts, overwrite, err))
        goto fail;
    if (mkdirat(dir_fd, "trusted", 0700) != 0 && errno != EEXIST) {
        err_set(err, ERR_IO, "%s/trusted: %s", dir, strerror(errno));
        goto fail;
    }
    generated = true;

fail:
    for (size_t i = 0; i < DRAFT_COUNT; i++)
        BIO_free(drafts[i].content);
    close(dir_fd);
    return generated;
}
