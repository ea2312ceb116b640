#include "master/ply.h"

#include "common/err.h"
#include "common/finite.h"
#include "master/number.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#define BUFFER_SIZE    (1 << 20)
#define LINE_MAX_BYTES 4096 /* of a header line */
#define TOKEN_MAX      128  /* of a number in an ascii file */
#define ELEMENT_MAX    64
#define PROPERTY_MAX   256       /* of all elements together */
#define RESERVE_BLIND  (1 << 16) /* elements reserved when the data's size is unknown */
#define SIZE_UNKNOWN   UINT64_MAX

/* --- A window that moves over the file ---------------------------------------------------- */

struct input {
    const char *name;
    int fd;          /* of a file as it is, or -1 */
    gzFile file;     /* of a compressed one, or NULL; with neither, all of it is in the window */
    uint8_t *buffer; /* the window's memory, when there is a file */
    const uint8_t *at, *end;
    uint64_t size; /* of the whole file, or SIZE_UNKNOWN */
    uint64_t line; /* while it is text */
    bool failed;   /* reading failed; the error is set */
};

/* Bytes read, 0 at the end of the file or when reading failed */
static size_t input_read(struct input *in, uint8_t *to, size_t size, struct err *err)
{
    const char *why = NULL;
    ssize_t got;
    if (in->file == NULL) {
        do
            got = read(in->fd, to, size);
        while (got < 0 && errno == EINTR);
        why = got < 0 ? strerror(errno) : NULL;
    } else {
        int code = Z_OK;
        got = gzread(in->file, to, (unsigned)size);
        const char *text = got <= 0 ? gzerror(in->file, &code) : "";
        if (got < 0 || (code != Z_OK && code != Z_BUF_ERROR))
            why = code == Z_ERRNO ? strerror(errno) : text;
    }
    if (why != NULL) {
        err_set(err, ERR_SCENE, "%s: reading failed: %s", in->name, why);
        in->failed = true;
    }
    return got > 0 ? (size_t)got : 0;
}

/* Bytes in the window: at least `wanted` (up to BUFFER_SIZE) unless the file ends before. */
static size_t input_fill(struct input *in, size_t wanted, struct err *err)
{
    size_t left = (size_t)(in->end - in->at);
    if (left >= wanted || in->buffer == NULL)
        return left;
    memmove(in->buffer, in->at, left);
    in->at = in->buffer;
    while (left < wanted) {
        size_t got = input_read(in, in->buffer + left, BUFFER_SIZE - left, err);
        if (got == 0)
            break;
        left += got;
    }
    in->end = in->buffer + left;
    return left;
}

/* --- The header --------------------------------------------------------------------------- */

enum type { INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64, TYPES };

static const struct {
    const char *name, *alias;
    size_t size;
} types[TYPES] = {
    [INT8] = { "char", "int8", 1 },        [UINT8] = { "uchar", "uint8", 1 },
    [INT16] = { "short", "int16", 2 },     [UINT16] = { "ushort", "uint16", 2 },
    [INT32] = { "int", "int32", 4 },       [UINT32] = { "uint", "uint32", 4 },
    [FLOAT32] = { "float", "float32", 4 }, [FLOAT64] = { "double", "float64", 8 },
};

enum role { X, Y, Z, NX, NY, NZ, U, V, INDICES, OTHER };
#define VALUE_ROLES INDICES /* those before it are single numbers of a vertex */

struct property {
    enum type type;  /* of the value, or of the list's items */
    enum type count; /* of a list's length */
    bool is_list;
    enum role role;
};

enum element_kind { ELEMENT_VERTEX, ELEMENT_FACE, ELEMENT_OTHER };

struct element {
    enum element_kind kind;
    uint64_t count;
    uint32_t first, properties;
};

enum format { FORMAT_NONE, ASCII, LITTLE, BIG };

struct ply {
    struct input in;
    enum format format;
    struct element elements[ELEMENT_MAX];
    uint32_t element_count;
    struct property properties[PROPERTY_MAX];
    uint32_t property_count;
    struct ply_target *target;
    struct ply_added *added;
};

/* The next header line, without its end, as a string; false at the end of the file */
static bool header_line(struct ply *ply, char line[LINE_MAX_BYTES], struct err *err)
{
    struct input *in = &ply->in;
    size_t available = input_fill(in, LINE_MAX_BYTES, err);
    if (in->failed)
        return false;
    if (available > LINE_MAX_BYTES)
        available = LINE_MAX_BYTES;
    const uint8_t *newline = memchr(in->at, '\n', available);
    in->line++;
    if (newline == NULL)
        return err_set(err, ERR_SCENE, "%s:%llu: %s", in->name, (unsigned long long)in->line,
                       available < LINE_MAX_BYTES ? "the file ends inside the PLY header"
                                                  : "a header line is too long");
    size_t length = (size_t)(newline - in->at);
    memcpy(line, in->at, length);
    while (length > 0 && line[length - 1] == '\r')
        length--;
    line[length] = '\0';
    in->at = newline + 1;
    return true;
}

static bool header_error(const struct ply *ply, struct err *err, const char *what, const char *word)
{
    return err_set(err, ERR_SCENE, "%s:%llu: %s \"%.64s\"", ply->in.name,
                   (unsigned long long)ply->in.line, what, word != NULL ? word : "");
}

static bool parse_type(const char *word, enum type *type)
{
    for (int i = 0; word != NULL && i < TYPES; i++)
        if (strcmp(word, types[i].name) == 0 || strcmp(word, types[i].alias) == 0) {
            *type = (enum type)i;
            return true;
        }
    return false;
}

static enum role parse_role(enum element_kind kind, const char *name, bool is_list)
{
    static const struct {
        const char *name;
        enum role role;
    } roles[] = {
        { "x", X },         { "y", Y },         { "z", Z },         { "nx", NX },
        { "ny", NY },       { "nz", NZ },       { "u", U },         { "v", V },
        { "s", U },         { "t", V },         { "texture_u", U }, { "texture_v", V },
        { "texture_s", U }, { "texture_t", V },
    };
    if (kind == ELEMENT_FACE && is_list &&
        (strcmp(name, "vertex_indices") == 0 || strcmp(name, "vertex_index") == 0))
        return INDICES;
    for (size_t i = 0; kind == ELEMENT_VERTEX && !is_list && i < sizeof(roles) / sizeof(roles[0]);
         i++)
        if (strcmp(name, roles[i].name) == 0)
            return roles[i].role;
    return OTHER;
}

static bool parse_element(struct ply *ply, char **rest, struct err *err)
{
    const char *name = strtok_r(NULL, " \t", rest), *count = strtok_r(NULL, " \t", rest);
    if (name == NULL || count == NULL || strspn(count, "0123456789") != strlen(count) ||
        strlen(count) > 18)
        return header_error(ply, err, "an element needs a name and a count, not", count);
    if (ply->element_count == ELEMENT_MAX)
        return header_error(ply, err, "too many elements at", name);
    struct element *element = &ply->elements[ply->element_count++];
    *element = (struct element){ ELEMENT_OTHER, strtoull(count, NULL, 10), ply->property_count, 0 };
    if (strcmp(name, "vertex") == 0)
        element->kind = ELEMENT_VERTEX;
    else if (strcmp(name, "face") == 0)
        element->kind = ELEMENT_FACE;
    else if (strcmp(name, "tristrips") == 0 && element->count > 0)
        return err_set(err, ERR_UNSUPPORTED,
                       "%s:%llu: triangle strips in PLY files are not supported yet", ply->in.name,
                       (unsigned long long)ply->in.line);
    for (uint32_t i = 0; element->kind != ELEMENT_OTHER && i + 1 < ply->element_count; i++)
        if (ply->elements[i].kind == element->kind)
            return header_error(ply, err, "a second element", name);
    return true;
}

static bool parse_property(struct ply *ply, char **rest, struct err *err)
{
    if (ply->element_count == 0)
        return header_error(ply, err, "a property comes before the first element", NULL);
    if (ply->property_count == PROPERTY_MAX)
        return header_error(ply, err, "too many properties", NULL);
    struct element *element = &ply->elements[ply->element_count - 1];
    struct property property = { 0 };
    const char *word = strtok_r(NULL, " \t", rest);
    property.is_list = word != NULL && strcmp(word, "list") == 0;
    if (property.is_list) {
        word = strtok_r(NULL, " \t", rest);
        if (!parse_type(word, &property.count) || property.count >= FLOAT32)
            return header_error(ply, err, "a list's length cannot be of type", word);
        word = strtok_r(NULL, " \t", rest);
    }
    if (!parse_type(word, &property.type))
        return header_error(ply, err, "unknown property type", word);
    const char *name = strtok_r(NULL, " \t", rest);
    if (name == NULL)
        return header_error(ply, err, "a property has no name after", word);
    property.role = parse_role(element->kind, name, property.is_list);
    if (property.role == INDICES && property.type >= FLOAT32)
        return header_error(ply, err, "vertex indices cannot be of type", word);
    ply->properties[ply->property_count++] = property;
    element->properties++;
    return true;
}

static bool has_role(const struct ply *ply, const struct element *element, enum role role)
{
    for (uint32_t i = 0; i < element->properties; i++)
        if (ply->properties[element->first + i].role == role)
            return true;
    return false;
}

/* Fewest bytes that an element with these properties can take */
static uint64_t smallest_record(const struct ply *ply, const struct element *element)
{
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < element->properties; i++) {
        const struct property *property = &ply->properties[element->first + i];
        if (ply->format == ASCII)
            bytes += 2; /* a digit and what ends it */
        else
            bytes += types[property->is_list ? property->count : property->type].size;
    }
    return bytes;
}

static bool check_claims(const struct ply *ply, struct err *err)
{
    const struct input *in = &ply->in;
    const struct element *vertices = NULL, *faces = NULL;
    uint64_t needed = 0;
    for (uint32_t i = 0; i < ply->element_count; i++) {
        const struct element *element = &ply->elements[i];
        uint64_t bytes;
        if (__builtin_mul_overflow(element->count, smallest_record(ply, element), &bytes) ||
            __builtin_add_overflow(needed, bytes, &needed))
            needed = SIZE_UNKNOWN - 1;
        if (element->kind == ELEMENT_VERTEX)
            vertices = element;
        else if (element->kind == ELEMENT_FACE)
            faces = element;
    }
    if (vertices == NULL || !has_role(ply, vertices, X) || !has_role(ply, vertices, Y) ||
        !has_role(ply, vertices, Z))
        return err_set(err, ERR_SCENE, "%s: no vertices with x, y and z", in->name);
    if (faces == NULL || !has_role(ply, faces, INDICES))
        return err_set(err, ERR_SCENE, "%s: no faces with vertex_indices", in->name);
    if (vertices->count > UINT32_MAX - 1)
        return err_set(err, ERR_SCENE, "%s: %llu vertices are too many", in->name,
                       (unsigned long long)vertices->count);
    if (in->size != SIZE_UNKNOWN && needed > in->size + 1) /* ascii may end without a newline */
        return err_set(err, ERR_SCENE,
                       "%s: the header claims %llu vertices and %llu faces, at least %llu bytes; "
                       "the whole file has %llu",
                       in->name, (unsigned long long)vertices->count,
                       (unsigned long long)faces->count, (unsigned long long)needed,
                       (unsigned long long)in->size);
    return true;
}

static bool read_header(struct ply *ply, struct err *err)
{
    char line[LINE_MAX_BYTES];
    if (!header_line(ply, line, err))
        return false;
    if (strcmp(line, "ply") != 0)
        return err_set(err, ERR_SCENE, "%s:1: not a PLY file: the first line is not \"ply\"",
                       ply->in.name);
    for (;;) {
        if (!header_line(ply, line, err))
            return false;
        char *rest;
        const char *word = strtok_r(line, " \t", &rest);
        if (word == NULL || strcmp(word, "comment") == 0 || strcmp(word, "obj_info") == 0)
            continue;
        if (strcmp(word, "end_header") == 0)
            break;
        if (strcmp(word, "format") == 0) {
            const char *format = strtok_r(NULL, " \t", &rest);
            if (format != NULL && strcmp(format, "ascii") == 0)
                ply->format = ASCII;
            else if (format != NULL && strcmp(format, "binary_little_endian") == 0)
                ply->format = LITTLE;
            else if (format != NULL && strcmp(format, "binary_big_endian") == 0)
                ply->format = BIG;
            else
                return header_error(ply, err, "unknown format", format);
        } else if (strcmp(word, "element") == 0) {
            if (!parse_element(ply, &rest, err))
                return false;
        } else if (strcmp(word, "property") == 0) {
            if (!parse_property(ply, &rest, err))
                return false;
        } else {
            return header_error(ply, err, "unknown header line", word);
        }
    }
    ply->in.line++; /* the body begins on the next one */
    if (ply->format == FORMAT_NONE)
        return err_set(err, ERR_SCENE, "%s: the PLY header names no format", ply->in.name);
    return check_claims(ply, err);
}

/* --- Values ------------------------------------------------------------------------------- */

static bool ended_early(const struct ply *ply, const char *what, uint64_t index, struct err *err)
{
    if (ply->in.failed)
        return false;
    return err_set(err, ERR_SCENE, "%s: the file ends early, in %s %llu", ply->in.name, what,
                   (unsigned long long)index);
}

static double decode(const uint8_t *at, enum type type, bool swap)
{
    uint8_t bytes[8];
    size_t size = types[type].size;
    for (size_t i = 0; i < size; i++)
        bytes[i] = at[swap ? size - 1 - i : i];
    switch (type) {
#define AS(ctype)                             \
    do {                                      \
        ctype value;                          \
        memcpy(&value, bytes, sizeof(value)); \
        return (double)value;                 \
    } while (0)
    case INT8:
        AS(int8_t);
    case UINT8:
        AS(uint8_t);
    case INT16:
        AS(int16_t);
    case UINT16:
        AS(uint16_t);
    case INT32:
        AS(int32_t);
    case UINT32:
        AS(uint32_t);
    case FLOAT32:
        AS(float);
    default:
        AS(double);
#undef AS
    }
}

static bool is_space(uint8_t c)
{
    return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}

/* One number, in the file's format; `what` and `index` are for the error */
static bool read_value(struct ply *ply, enum type type, double *value, const char *what,
                       uint64_t index, struct err *err)
{
    struct input *in = &ply->in;
    if (ply->format != ASCII) {
        if (input_fill(in, types[type].size, err) < types[type].size)
            return ended_early(ply, what, index, err);
        *value = decode(in->at, type, ply->format == BIG);
        in->at += types[type].size;
        return true;
    }
    for (;;) {
        if (input_fill(in, 1, err) == 0)
            return ended_early(ply, what, index, err);
        while (in->at < in->end && is_space(*in->at))
            in->line += *in->at++ == '\n';
        if (in->at < in->end)
            break;
    }
    size_t available = input_fill(in, TOKEN_MAX, err), length = 0;
    while (length < available && length < TOKEN_MAX && !is_space(in->at[length]))
        length++;
    const char *token = (const char *)in->at;
    if (!number_parse(token, token + length, value))
        return err_set(err, ERR_SCENE, "%s:%llu: \"%.*s\" is not a number (%s %llu)", in->name,
                       (unsigned long long)in->line, (int)(length < 32 ? length : 32), token, what,
                       (unsigned long long)index);
    in->at += length;
    return true;
}

static bool read_list_length(struct ply *ply, const struct property *property, uint64_t *length,
                             const char *what, uint64_t index, struct err *err)
{
    double value;
    if (!read_value(ply, property->count, &value, what, index, err))
        return false;
    if (!(value >= 0) || value > UINT32_MAX || value != floor(value))
        return err_set(err, ERR_SCENE, "%s: %s %llu: a list of %g items", ply->in.name, what,
                       (unsigned long long)index, value);
    *length = (uint64_t)value;
    return true;
}

static bool skip_property(struct ply *ply, const struct property *property, const char *what,
                          uint64_t index, struct err *err)
{
    uint64_t length = 1;
    if (property->is_list && !read_list_length(ply, property, &length, what, index, err))
        return false;
    for (uint64_t i = 0; i < length; i++) {
        double value;
        if (!read_value(ply, property->type, &value, what, index, err))
            return false;
    }
    return true;
}

/* --- Vertices ----------------------------------------------------------------------------- */

/* Where the records have a fixed layout of little-endian floats: byte offsets by role */
struct layout {
    size_t stride;
    ptrdiff_t offset[VALUE_ROLES]; /* -1: absent */
};

static bool vertex_layout(const struct ply *ply, const struct element *element,
                          struct layout *layout)
{
    if (ply->format != LITTLE)
        return false;
    layout->stride = 0;
    for (int role = 0; role < VALUE_ROLES; role++)
        layout->offset[role] = -1;
    for (uint32_t i = 0; i < element->properties; i++) {
        const struct property *property = &ply->properties[element->first + i];
        if (property->is_list || (property->role < VALUE_ROLES && property->type != FLOAT32))
            return false;
        if (property->role < VALUE_ROLES)
            layout->offset[property->role] = (ptrdiff_t)layout->stride;
        layout->stride += types[property->type].size;
    }
    return true;
}

struct vertex_out {
    float *positions, *normals, *uvs; /* of the records about to be read; NULL: not wanted */
    double *wide;
};

/* Append `count` vertices to all arrays that this file fills */
static bool add_vertices(struct ply *ply, size_t count, struct vertex_out *out, struct err *err)
{
    struct ply_target *target = ply->target;
    const struct ply_added *added = ply->added;
    *out = (struct vertex_out){ 0 };
    out->positions = growing_add(&target->positions, count, 3 * sizeof(float));
    if (added->has_normals)
        out->normals = growing_add(&target->normals, count, 3 * sizeof(float));
    if (added->has_uvs)
        out->uvs = growing_add(&target->uvs, count, 2 * sizeof(float));
    if (added->has_wide)
        out->wide = growing_add(&target->wide, count, 3 * sizeof(double));
    if (out->positions == NULL || (added->has_normals && out->normals == NULL) ||
        (added->has_uvs && out->uvs == NULL) || (added->has_wide && out->wide == NULL))
        return err_set(err, ERR_MEMORY, "%s: no memory for the vertices", ply->in.name);
    return true;
}

/* `fields` floats of every record, which follow one another as most exporters write them, or not */
static void copy_fields(const uint8_t *records, const struct layout *layout, enum role first,
                        size_t fields, size_t count, float *out)
{
    const ptrdiff_t *offset = layout->offset + first;
    const size_t stride = layout->stride, size = fields * sizeof(float);
    bool together = true;
    for (size_t field = 1; field < fields; field++)
        together &= offset[field] == offset[0] + (ptrdiff_t)(field * sizeof(float));
    if (together && stride == size)
        memcpy(out, records, count * size);
    else if (together && fields == 3)
        for (size_t i = 0; i < count; i++)
            memcpy(out + 3 * i, records + i * stride + offset[0], 3 * sizeof(float));
    else
        for (size_t i = 0; i < count; i++)
            for (size_t field = 0; field < fields; field++)
                memcpy(out + i * fields + field, records + i * stride + offset[field],
                       sizeof(float));
}

static bool read_vertices_fast(struct ply *ply, const struct element *element,
                               const struct layout *layout, struct err *err)
{
    struct input *in = &ply->in;
    for (uint64_t done = 0; done < element->count;) {
        size_t records = input_fill(in, layout->stride, err) / layout->stride;
        if (records == 0)
            return ended_early(ply, "vertex", done, err);
        if (records > element->count - done)
            records = (size_t)(element->count - done);
        struct vertex_out out;
        if (!add_vertices(ply, records, &out, err))
            return false;
        copy_fields(in->at, layout, X, 3, records, out.positions);
        if (out.normals != NULL)
            copy_fields(in->at, layout, NX, 3, records, out.normals);
        if (out.uvs != NULL)
            copy_fields(in->at, layout, U, 2, records, out.uvs);
        in->at += records * layout->stride;
        done += records;
    }
    return true;
}

static bool read_vertices_any(struct ply *ply, const struct element *element, struct err *err)
{
    for (uint64_t i = 0; i < element->count; i++) {
        double values[VALUE_ROLES] = { 0 };
        for (uint32_t p = 0; p < element->properties; p++) {
            const struct property *property = &ply->properties[element->first + p];
            if (property->role >= VALUE_ROLES) {
                if (!skip_property(ply, property, "vertex", i, err))
                    return false;
            } else if (!read_value(ply, property->type, &values[property->role], "vertex", i,
                                   err)) {
                return false;
            }
        }
        struct vertex_out out;
        if (!add_vertices(ply, 1, &out, err))
            return false;
        for (int axis = 0; axis < 3; axis++)
            out.positions[axis] = (float)values[X + axis];
        for (int axis = 0; out.wide != NULL && axis < 3; axis++)
            out.wide[axis] = values[X + axis];
        for (int axis = 0; out.normals != NULL && axis < 3; axis++)
            out.normals[axis] = (float)values[NX + axis];
        for (int axis = 0; out.uvs != NULL && axis < 2; axis++)
            out.uvs[axis] = (float)values[U + axis];
    }
    return true;
}

static bool check_finite(const struct ply *ply, const char *what, const float *values, size_t count,
                         struct err *err)
{
    if (finite_all(values, count))
        return true;
    for (size_t i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return err_set(err, ERR_SCENE, "%s: vertex %zu: its %s is not finite", ply->in.name,
                           i / 3, what);
    return true;
}

static bool read_vertices(struct ply *ply, const struct element *element, struct err *err)
{
    struct ply_target *target = ply->target;
    struct ply_added *added = ply->added;
    added->has_normals = has_role(ply, element, NX) && has_role(ply, element, NY) &&
                         has_role(ply, element, NZ);
    added->has_uvs = has_role(ply, element, U) && has_role(ply, element, V);
    for (uint32_t i = 0; i < element->properties; i++) {
        const struct property *property = &ply->properties[element->first + i];
        added->has_wide = added->has_wide || (property->role <= Z && property->type == FLOAT64);
    }

    size_t known = ply->in.size != SIZE_UNKNOWN || element->count < RESERVE_BLIND
                       ? (size_t)element->count
                       : RESERVE_BLIND;
    size_t first = target->positions.count, first_normal = target->normals.count;
    if (first + element->count > UINT32_MAX - 1)
        return err_set(err, ERR_SCENE, "%s: the scene has more than 2^32 vertices", ply->in.name);
    if (!growing_reserve(&target->positions, known, 3 * sizeof(float)) ||
        (added->has_normals && !growing_reserve(&target->normals, known, 3 * sizeof(float))) ||
        (added->has_uvs && !growing_reserve(&target->uvs, known, 2 * sizeof(float))))
        return err_set(err, ERR_MEMORY, "%s: no memory for %llu vertices", ply->in.name,
                       (unsigned long long)element->count);

    struct layout layout;
    bool read = vertex_layout(ply, element, &layout)
                    ? read_vertices_fast(ply, element, &layout, err)
                    : read_vertices_any(ply, element, err);
    if (!read)
        return false;
    return check_finite(ply, "position", (float *)target->positions.data + 3 * first,
                        3 * (size_t)element->count, err) &&
           (!added->has_normals ||
            check_finite(ply, "normal", (float *)target->normals.data + 3 * first_normal,
                         3 * (size_t)element->count, err));
}

/* --- Faces -------------------------------------------------------------------------------- */

static bool index_error(const struct ply *ply, uint64_t face, double index, struct err *err)
{
    return err_set(err, ERR_SCENE, "%s: face %llu: vertex index %.0f is out of range (%u vertices)",
                   ply->in.name, (unsigned long long)face, index, ply->added->vertex_count);
}

static bool no_memory_for_faces(const struct ply *ply, struct err *err)
{
    return err_set(err, ERR_MEMORY, "%s: no memory for the triangles", ply->in.name);
}

/* The common layout: nothing but a byte of length and 32-bit indices. Triangles and quads; stops
 * in front of the first other face and returns the number of faces read. */
static bool read_faces_fast(struct ply *ply, uint64_t limit, uint64_t *faces, struct err *err)
{
    enum { TRIANGLE = 1 + 3 * 4, QUAD = 1 + 4 * 4 };
    struct input *in = &ply->in;
    struct growing *triangles = &ply->target->triangles;
    const uint32_t first = ply->added->first_vertex, vertices = ply->added->vertex_count;
    for (*faces = 0; *faces < limit;) {
        size_t available = input_fill(in, QUAD, err), most = available / TRIANGLE;
        most = most < limit - *faces ? most : (size_t)(limit - *faces);
        if (!growing_reserve(triangles, most, 3 * sizeof(uint32_t)))
            return no_memory_for_faces(ply, err);
        const uint8_t *at = in->at, *end = at + available;
        uint32_t *out = (uint32_t *)triangles->data + 3 * triangles->count;
        uint32_t corner[4] = { 0 };
        size_t done = 0, made = 0;
        for (; done < most && made < most; done++) {
            bool quad = at[0] == 4;
            if ((at[0] != 3 && !quad) || end - at < (quad ? QUAD : TRIANGLE))
                break;
            memcpy(corner, at + 1, 3 * sizeof(uint32_t));
            if (quad)
                memcpy(corner + 3, at + TRIANGLE, sizeof(uint32_t));
            if ((corner[0] >= vertices) | (corner[1] >= vertices) | (corner[2] >= vertices) |
                (quad & (corner[3] >= vertices)))
                break;
            if (quad && made + 2 > most) /* the next round has room for both */
                break;
            out[0] = first + corner[0];
            out[1] = first + corner[1];
            out[2] = first + corner[2];
            if (quad) {
                out[3] = first + corner[0];
                out[4] = first + corner[2];
                out[5] = first + corner[3];
            }
            out += quad ? 6 : 3;
            made += quad ? 2 : 1;
            at += quad ? QUAD : TRIANGLE;
        }
        in->at = at;
        triangles->count += made;
        *faces += done;
        if (made == 0)
            break; /* another kind of face, a bad index or the end: the general way says which */
    }
    return !in->failed;
}

/* A polygon becomes a fan around its first corner */
static bool read_polygon(struct ply *ply, const struct property *property, uint64_t face,
                         struct err *err)
{
    struct ply_added *added = ply->added;
    uint64_t length;
    if (!read_list_length(ply, property, &length, "face", face, err))
        return false;
    if (length < 3)
        added->flat_faces++;
    uint32_t first = 0, previous = 0;
    for (uint64_t i = 0; i < length; i++) {
        double value;
        if (!read_value(ply, property->type, &value, "face", face, err))
            return false;
        if (!(value >= 0 && value < added->vertex_count) || value != floor(value))
            return index_error(ply, face, value, err);
        uint32_t corner = added->first_vertex + (uint32_t)value;
        if (i >= 2) {
            uint32_t *triangle = growing_add(&ply->target->triangles, 1, 3 * sizeof(uint32_t));
            if (triangle == NULL)
                return no_memory_for_faces(ply, err);
            triangle[0] = first;
            triangle[1] = previous;
            triangle[2] = corner;
        }
        if (i == 0)
            first = corner;
        previous = corner;
    }
    return true;
}

static bool read_faces(struct ply *ply, const struct element *element, struct err *err)
{
    const struct property *properties = &ply->properties[element->first];
    bool plain = ply->format == LITTLE && element->properties == 1 &&
                 types[properties[0].count].size == 1 && types[properties[0].type].size == 4;
    if (ply->in.size != SIZE_UNKNOWN &&
        !growing_reserve(&ply->target->triangles, (size_t)element->count, 3 * sizeof(uint32_t)))
        return no_memory_for_faces(ply, err);

    for (uint64_t face = 0; face < element->count; face++) {
        if (plain) {
            uint64_t read;
            if (!read_faces_fast(ply, element->count - face, &read, err))
                return false;
            face += read;
            if (face == element->count)
                break;
        }
        for (uint32_t p = 0; p < element->properties; p++) {
            bool good = properties[p].role == INDICES
                            ? read_polygon(ply, &properties[p], face, err)
                            : skip_property(ply, &properties[p], "face", face, err);
            if (!good)
                return false;
        }
    }
    return true;
}

/* --- The file ----------------------------------------------------------------------------- */

static bool read_other(struct ply *ply, const struct element *element, struct err *err)
{
    if (element->properties == 0)
        return true; /* however many: they have no bytes */
    for (uint64_t i = 0; i < element->count; i++)
        for (uint32_t p = 0; p < element->properties; p++)
            if (!skip_property(ply, &ply->properties[element->first + p], "element", i, err))
                return false;
    return true;
}

static bool read_body(struct ply *ply, struct err *err)
{
    struct ply_added *added = ply->added;
    *added = (struct ply_added){ .first_vertex = (uint32_t)ply->target->positions.count,
                                 .first_triangle = (uint32_t)ply->target->triangles.count };
    for (uint32_t i = 0; i < ply->element_count; i++)
        if (ply->elements[i].kind == ELEMENT_VERTEX)
            added->vertex_count = (uint32_t)ply->elements[i].count;

    for (uint32_t i = 0; i < ply->element_count; i++) {
        const struct element *element = &ply->elements[i];
        bool good = element->kind == ELEMENT_VERTEX ? read_vertices(ply, element, err)
                    : element->kind == ELEMENT_FACE ? read_faces(ply, element, err)
                                                    : read_other(ply, element, err);
        if (!good)
            return false;
    }
    size_t triangles = ply->target->triangles.count;
    if (triangles > UINT32_MAX / 3)
        return err_set(err, ERR_SCENE, "%s: the scene has too many triangles", ply->in.name);
    added->triangle_count = (uint32_t)(triangles - added->first_triangle);
    return true;
}

static bool read_ply(const struct input *in, struct ply_target *target, struct ply_added *added,
                     struct err *err)
{
    struct ply *ply = calloc(1, sizeof(*ply));
    if (ply == NULL)
        return err_set(err, ERR_MEMORY, "%s: no memory", in->name);
    ply->in = *in;
    ply->target = target;
    ply->added = added;
    bool good = read_header(ply, err) && read_body(ply, err);
    free(ply);
    return good;
}

bool ply_read_bytes(const void *bytes, size_t size, const char *name, struct ply_target *target,
                    struct ply_added *added, struct err *err)
{
    struct input in = { .name = name, .fd = -1, .at = bytes, .size = size };
    in.end = size > 0 ? in.at + size : in.at;
    return read_ply(&in, target, added, err);
}

/* By the two bytes that every gzip file begins with; the file's offset stays */
static bool is_compressed(int fd)
{
    uint8_t magic[2];
    return pread(fd, magic, sizeof(magic), 0) == sizeof(magic) && magic[0] == 0x1f &&
           magic[1] == 0x8b;
}

bool ply_read(const char *path, struct ply_target *target, struct ply_added *added, struct err *err)
{
    bool good = false;
    struct stat status;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0 || fstat(fd, &status) != 0) {
        err_set(err, ERR_SCENE, "%s: cannot be opened: %s", path, strerror(errno));
        goto fail_open;
    }
    if (!S_ISREG(status.st_mode)) {
        err_set(err, ERR_SCENE, "%s: not a regular file", path);
        goto fail_open;
    }
    struct input in = {
        .name = path, .fd = fd, .size = (uint64_t)status.st_size, .buffer = malloc(BUFFER_SIZE)
    };
    if (in.buffer == NULL) {
        err_set(err, ERR_MEMORY, "%s: no memory", path);
        goto fail_open;
    }
    in.at = in.end = in.buffer;
    if (is_compressed(fd)) {
        in.file = gzdopen(fd, "rb");
        if (in.file == NULL) {
            err_set(err, ERR_MEMORY, "%s: no memory", path);
            goto fail_file;
        }
        gzbuffer(in.file, 1 << 18);
        in.size = SIZE_UNKNOWN;
        fd = -1; /* closed with it */
    }
    good = read_ply(&in, target, added, err);
    if (in.file != NULL)
        gzclose(in.file);
fail_file:
    free(in.buffer);
fail_open:
    if (fd >= 0)
        close(fd);
    return good;
}
