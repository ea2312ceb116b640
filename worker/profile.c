#include "worker/profile.h"

#include "common/err.h"
#include "worker/renderer.h"

#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#if defined(__x86_64__)
/* Flush to zero (15), denormals are zero (6), all six exceptions masked (12..7), nearest (14,13) */
#define MODE_RENDER ((1u << 15) | (1u << 6) | (0x3fu << 7))

static unsigned mode_get(void)
{
    return _mm_getcsr();
}

static void mode_set(unsigned mode)
{
    _mm_setcsr(mode);
}
#elif defined(__aarch64__)
#define MODE_RENDER (1u << 24) /* FPCR.FZ; rounding and traps are zero bits */

static unsigned mode_get(void)
{
    uint64_t fpcr;
    __asm__ volatile("mrs %0, fpcr" : "=r"(fpcr));
    return (unsigned)fpcr;
}

static void mode_set(unsigned mode)
{
    __asm__ volatile("msr fpcr, %0" : : "r"((uint64_t)mode));
}
#else
#error "say how this processor's floating-point mode is set"
#endif

void profile_thread_mode(void)
{
    mode_set(MODE_RENDER);
}

bool profile_take(const struct renderer_class *renderer, struct profile *out, struct err *err)
{
    unsigned before = mode_get();
    memset(out, 0, sizeof(*out));
    profile_thread_mode();
    bool taken = renderer->profile(out->digest, out->text, sizeof(out->text), err);
    mode_set(before);
    if (!taken)
        return err_wrap(err, "numeric profile of renderer \"%s\"", renderer->name);
    return true;
}
