#include "common/aov.h"

#include <assert.h>

static const struct {
    const char *name;
    uint32_t channels;
} layers[AOV_COUNT] = {
#define X(name, bit, text, channels) [bit] = { text, channels },
    AOV_MAP(X)
#undef X
};

/* Where the layers below `end` end */
static uint32_t channels_before(uint32_t aovs, unsigned end)
{
    uint32_t count = aovs == 0 ? AOV_COVERAGE_CHANNEL : AOV_COVERAGE_CHANNEL + 1;
    for (unsigned aov = 0; aov < end; aov++)
        if (aov_in(aovs, aov))
            count += layers[aov].channels;
    return count;
}

uint32_t aov_channel_count(uint32_t aovs)
{
    return channels_before(aovs, AOV_COUNT);
}

uint32_t aov_channel(uint32_t aovs, enum aov aov)
{
    assert(aov_in(aovs, aov));
    return channels_before(aovs, aov);
}

const char *aov_name(enum aov aov)
{
    return layers[aov].name;
}
