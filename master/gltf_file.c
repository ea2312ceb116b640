#include "master/gltf_file.h"

#include "master/gltf_reader.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <openssl/evp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define ALLOWANCE_FLAT                                                            \
    ((uint64_t)32 << 20)     /* half of what a file may make us take: arrays grow \
                              */
#define ALLOWANCE_EACH    32 /* by halves, and the scene is finished from them */
#define GLB_MAGIC         0x46546c67u
#define GLB_JSON          0x4e4f534au
#define GLB_BIN           0x004e4942u
#define JSON_OBJECT_BYTES 320 /* jansson's object with its hash table, and its place in a list */
#define JSON_LIST_BYTES   160

struct gltf_buffer {
    unsigned char *owned;
    struct gltf_bytes bytes;
    bool loaded;
};

void gltf_file_free(struct gltf_file *file)
{
    struct gltf_buffer *buffers = file->buffers.data;
    for (size_t i = 0; i < file->buffers.count; i++)
        free(buffers[i].owned);
    growing_free(&file->buffers);
    json_decref(file->json);
    free(file->content);
    free(file->folder);
}

bool gltf_file_spend(struct gltf_reader *reader, uint64_t count, size_t size, const char *where)
{
    if (count > (reader->file.allowance - reader->file.spent) / size)
        return gltf_report_error(reader, where,
                                 "the file is far smaller than what it makes of its data");
    reader->file.spent += count * size;
    return true;
}

/* --- Files -------------------------------------------------------------------------------- */

/* A regular file, and how long it is; -1 after an error. Opening must not block on a pipe. */
static int open_regular(struct gltf_reader *reader, const char *path, const char *where,
                        uint64_t *size)
{
    struct stat stat;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    const char *problem = fd < 0                   ? strerror(errno)
                          : fstat(fd, &stat) != 0  ? strerror(errno)
                          : !S_ISREG(stat.st_mode) ? "not a regular file"
                                                   : NULL;
    if (problem == NULL) {
        *size = (uint64_t)stat.st_size;
        return fd;
    }
    if (fd >= 0)
        close(fd);
    reader->failed = true;
    err_set(reader->err, ERR_IO, "%s: %s", path, problem);
    if (strcmp(path, reader->report.path) != 0)
        gltf_report_wrap(reader, where);
    return -1;
}

/* The first `size` bytes of a file that has so many */
static unsigned char *read_bytes(struct gltf_reader *reader, int fd, uint64_t size,
                                 const char *where)
{
    unsigned char *bytes = size < SIZE_MAX ? malloc(size + 1) : NULL;
    if (bytes == NULL) {
        gltf_report_no_memory(reader);
        return NULL;
    }
    for (uint64_t at = 0; at < size;) {
        ssize_t got = read(fd, bytes + at, size - at);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0) {
            gltf_report_error(reader, where, "reading ends early: %s",
                              got < 0 ? strerror(errno) : "the file was shortened meanwhile");
            free(bytes);
            return NULL;
        }
        at += (uint64_t)got;
    }
    return bytes;
}

/* --- URIs --------------------------------------------------------------------------------- */

bool gltf_file_is_data(const char *uri)
{
    return strncmp(uri, "data:", 5) == 0;
}

unsigned char *gltf_file_data(struct gltf_reader *reader, const char *uri, const char *where,
                              size_t *size)
{
    const char *comma = strchr(uri, ',');
    if (comma == NULL || comma - uri < 12 || strncmp(comma - 7, ";base64", 7) != 0) {
        gltf_report_error(reader, where, "a data: URI that is not base64");
        return NULL;
    }
    const char *text = comma + 1;
    size_t length = strlen(text), unpadded = length;
    while (unpadded > 0 && text[unpadded - 1] == '=' && length - unpadded < 2)
        unpadded--;
    /* What EVP_DecodeBlock would skip is not base64 here */
    size_t valid = strspn(text, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/");
    if (valid != unpadded || length % 4 != 0 || length > INT_MAX) {
        gltf_report_error(reader, where, "the base64 data is damaged at character %zu", valid);
        return NULL;
    }
    unsigned char *bytes = malloc(length / 4 * 3 + 1);
    if (bytes == NULL) {
        gltf_report_no_memory(reader);
        return NULL;
    }
    int decoded = EVP_DecodeBlock(bytes, (const unsigned char *)text, (int)length);
    *size = decoded > 0 ? (size_t)decoded - (length - unpadded) : 0;
    return bytes;
}

static int hex(char c)
{
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

/* %41 is A; in place. False for what is no byte of a name. */
static bool unescape(char *text)
{
    char *out = text;
    for (; *text != '\0'; text++) {
        char c = *text;
        if (c == '%') {
            int high = hex(text[1]), low = high < 0 ? -1 : hex(text[2]);
            if (low < 0 || (high == 0 && low == 0))
                return false;
            c = (char)(16 * high + low);
            text += 2;
        }
        *out++ = c;
    }
    *out = '\0';
    return true;
}

static bool has_scheme(const char *uri)
{
    if (!isalpha((unsigned char)uri[0]))
        return false;
    while (isalnum((unsigned char)*uri) || *uri == '+' || *uri == '-' || *uri == '.')
        uri++;
    return *uri == ':';
}

char *gltf_file_path(struct gltf_reader *reader, const char *uri, const char *where)
{
    const char *folder = reader->file.folder;
    if (folder == NULL) {
        gltf_report_error(reader, where, "no file can be read from here, not even \"%s\"", uri);
        return NULL;
    }
    char *path = malloc(strlen(folder) + strlen(uri) + 1);
    if (path == NULL) {
        gltf_report_no_memory(reader);
        return NULL;
    }
    char *name = stpcpy(path, folder);
    strcpy(name, uri);
    if (has_scheme(uri) || !unescape(name) || name[0] == '/' || name[0] == '\0') {
        gltf_report_error(reader, where, "\"%s\" is not a relative path", uri);
    } else {
        uint64_t size;
        int fd = open_regular(reader, path, where, &size);
        if (fd >= 0) {
            close(fd);
            return path;
        }
    }
    free(path);
    return NULL;
}

/* --- Opening ------------------------------------------------------------------------------ */

/* Many empty objects take far more memory than their text: would these? */
static bool json_fits(struct gltf_reader *reader, struct gltf_bytes text)
{
    uint64_t need = 0;
    for (size_t i = 0; i < text.size; i++)
        need += text.data[i] == '{' ? JSON_OBJECT_BYTES : text.data[i] == '[' ? JSON_LIST_BYTES : 0;
    if (need <= ALLOWANCE_FLAT + ALLOWANCE_EACH * (uint64_t)text.size)
        return true;
    return gltf_report_error(reader, "", "too many objects without content");
}

static bool parse(struct gltf_reader *reader, struct gltf_bytes text)
{
    json_error_t error;
    if (text.size >= 3 && memcmp(text.data, "\xef\xbb\xbf", 3) == 0) {
        text.data += 3;
        text.size -= 3;
    }
    if (!json_fits(reader, text))
        return false;
    reader->file.json = json_loadb((const char *)text.data, text.size, 0, &error);
    if (reader->file.json == NULL) {
        for (char *c = error.text; *c != '\0'; c++)
            *c = (unsigned char)*c < ' ' ? ' ' : *c;
        reader->failed = true;
        return err_set(reader->err, ERR_SCENE, "%s:%d:%d: %s", reader->report.path, error.line,
                       error.column, error.text);
    }
    if (!json_is_object(reader->file.json))
        return gltf_report_error(reader, "", "the JSON is not an object");
    return true;
}

static uint32_t get_u32(const unsigned char *bytes)
{
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

/* 12 bytes of header, then chunks of length, type and data: the JSON first, then the buffer */
static bool split_glb(struct gltf_reader *reader, struct gltf_bytes all, struct gltf_bytes *text)
{
    uint32_t version = get_u32(all.data + 4), length = get_u32(all.data + 8);
    if (version != 2)
        return gltf_report_error(reader, "", "a GLB of version %u; 2 is known", version);
    if (length > all.size)
        return gltf_report_error(reader, "", "the file ends after %zu of %u bytes", all.size,
                                 length);
    *text = (struct gltf_bytes){ 0 };
    size_t at = 12, number = 0;
    for (; at + 8 <= length; number++) {
        uint32_t size = get_u32(all.data + at), type = get_u32(all.data + at + 4);
        at += 8;
        if (size > length - at)
            return gltf_report_error(reader, "", "chunk %zu reaches beyond the end", number);
        if (number == 0 && type == GLB_JSON)
            *text = (struct gltf_bytes){ all.data + at, size };
        if (number == 1 && type == GLB_BIN)
            reader->file.chunk = (struct gltf_bytes){ all.data + at, size };
        at += size;
    }
    return text->data != NULL || gltf_report_error(reader, "", "the first chunk is not JSON");
}

static bool check_version(struct gltf_reader *reader)
{
    struct gltf_item root = gltf_json_root(reader);
    struct gltf_item asset = gltf_json_child(reader, &root, "asset");
    const char *version = gltf_json_text(reader, &asset, "version");
    const char *least = gltf_json_text(reader, &asset, "minVersion");
    if (reader->failed)
        return false;
    if (version == NULL)
        return gltf_report_error(reader, "asset", "\"version\" is missing: this is not glTF 2");
    if (strncmp(version, "2.", 2) != 0 || (least != NULL && strcmp(least, "2.0") != 0))
        return gltf_report_error(reader, "asset", "glTF %s; 2.0 is known",
                                 least != NULL ? least : version);
    return true;
}

bool gltf_file_open_bytes(struct gltf_reader *reader, const void *bytes, size_t size,
                          const char *name)
{
    struct gltf_file *file = &reader->file;
    struct gltf_bytes text = { bytes, size };
    file->allowance = ALLOWANCE_FLAT + ALLOWANCE_EACH * (uint64_t)size;
    if (name != NULL) {
        const char *slash = strrchr(name, '/');
        file->folder = strndup(name, slash == NULL ? 0 : (size_t)(slash + 1 - name));
        if (file->folder == NULL)
            return gltf_report_no_memory(reader);
    }
    if (size >= 12 && get_u32(text.data) == GLB_MAGIC && !split_glb(reader, text, &text))
        return false;
    if (!parse(reader, text) || !check_version(reader))
        return false;
    size_t buffers = gltf_json_count(reader, "buffers");
    struct gltf_buffer *added = growing_add(&file->buffers, buffers, sizeof(*added));
    if (added == NULL)
        return gltf_report_no_memory(reader);
    memset(added, 0, buffers * sizeof(*added));
    return true;
}

bool gltf_file_open(struct gltf_reader *reader, const char *path)
{
    uint64_t size;
    int fd = open_regular(reader, path, "", &size);
    if (fd < 0)
        return false;
    reader->file.content = read_bytes(reader, fd, size, "");
    close(fd);
    return reader->file.content != NULL &&
           gltf_file_open_bytes(reader, reader->file.content, (size_t)size, path);
}

/* --- Buffers ------------------------------------------------------------------------------ */

static bool load_file(struct gltf_reader *reader, const char *uri, const char *where,
                      uint64_t wanted, struct gltf_buffer *buffer)
{
    char *path = gltf_file_path(reader, uri, where);
    uint64_t size = 0;
    int fd = path != NULL ? open_regular(reader, path, where, &size) : -1;
    free(path);
    if (fd < 0)
        return false;
    size = size < wanted ? size : wanted;
    buffer->owned = read_bytes(reader, fd, size, where);
    close(fd);
    buffer->bytes = (struct gltf_bytes){ buffer->owned, size };
    if (buffer->owned != NULL)
        reader->file.allowance += ALLOWANCE_EACH * size;
    return buffer->owned != NULL;
}

static bool load(struct gltf_reader *reader, uint32_t index, const struct gltf_item *item,
                 struct gltf_buffer *buffer)
{
    const char *uri = gltf_json_text(reader, item, "uri");
    uint64_t wanted = gltf_json_size(reader, item, "byteLength", 0);
    if (reader->failed)
        return false;
    if (uri == NULL && index == 0 && reader->file.chunk.data != NULL) {
        buffer->bytes = reader->file.chunk;
    } else if (uri == NULL) {
        return gltf_report_error(reader, item->where, "there is neither \"uri\" nor a chunk");
    } else if (gltf_file_is_data(uri)) {
        buffer->owned = gltf_file_data(reader, uri, item->where, &buffer->bytes.size);
        buffer->bytes.data = buffer->owned;
        if (buffer->owned == NULL)
            return false;
    } else if (!load_file(reader, uri, item->where, wanted, buffer)) {
        return false;
    }
    if (buffer->bytes.size < wanted)
        return gltf_report_error(reader, item->where, "%zu of %llu bytes are there",
                                 buffer->bytes.size, (unsigned long long)wanted);
    buffer->bytes.size = (size_t)wanted;
    return true;
}

bool gltf_file_view(struct gltf_reader *reader, uint32_t index, const struct gltf_item *from,
                    struct gltf_bytes *bytes, size_t *stride)
{
    struct gltf_item view, item;
    if (!gltf_json_find(reader, "bufferViews", index, from, &view))
        return false;
    uint32_t number = gltf_json_index(reader, &view, "buffer");
    uint64_t offset = gltf_json_size(reader, &view, "byteOffset", 0);
    uint64_t length = gltf_json_size(reader, &view, "byteLength", 0);
    uint64_t step = gltf_json_size(reader, &view, "byteStride", 0);
    if (reader->failed || !gltf_json_find(reader, "buffers", number, &view, &item))
        return false;
    struct gltf_buffer *buffer = (struct gltf_buffer *)reader->file.buffers.data + number;
    if (!buffer->loaded && !load(reader, number, &item, buffer))
        return false;
    buffer->loaded = true;
    if (offset > buffer->bytes.size || length > buffer->bytes.size - offset)
        return gltf_report_error(reader, view.where, "it reaches beyond %s of %zu bytes",
                                 item.where, buffer->bytes.size);
    if (step > 252)
        return gltf_report_error(reader, view.where, "a stride of %llu bytes; 252 is the most",
                                 (unsigned long long)step);
    *bytes = (struct gltf_bytes){ buffer->bytes.data + offset, (size_t)length };
    *stride = (size_t)step;
    return true;
}
