#include "common/bytes.h"

#include "common/err.h"

#include <string.h>

const void *bytes_span(struct reader *in, size_t size)
{
    if (in->failure != NULL)
        return NULL;
    if (size > (size_t)(in->end - in->at)) {
        in->failure = "ends early";
        return NULL;
    }
    const uint8_t *span = in->at;
    if (size > 0)
        in->at += size;
    return span;
}

void bytes_read(struct reader *in, void *to, size_t size)
{
    if (size == 0)
        return;
    const void *span = bytes_span(in, size);
    if (span != NULL)
        memcpy(to, span, size);
    else
        memset(to, 0, size);
}

bool bytes_read_all(const struct reader *in, struct err *err)
{
    if (in->failure != NULL)
        return err_set(err, ERR_MESSAGE, "%s", in->failure);
    if (in->at != in->end)
        return err_set(err, ERR_MESSAGE, "%zu bytes left over", (size_t)(in->end - in->at));
    return true;
}

void bytes_write(struct writer *out, const void *from, size_t size)
{
    /* Once something found no room nothing after it is written either, so no holes */
    if (size > 0 && out->size <= out->capacity && size <= out->capacity - out->size)
        memcpy(out->bytes + out->size, from, size);
    out->size += size;
}

bool bytes_fit(const struct writer *out)
{
    return out->size <= out->capacity;
}
