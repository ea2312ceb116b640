#include "common/sumtree.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#define VALUES_ALIGNMENT ((size_t)64) /* a cache line, and every vector width */

static size_t round_up(size_t size, size_t alignment)
{
    return (size + alignment - 1) / alignment * alignment;
}

size_t node_sums_size(uint32_t pixel_count, uint32_t channel_count)
{
    size_t values = (size_t)pixel_count * channel_count * sizeof(float);
    return round_up(sizeof(struct node_sums), VALUES_ALIGNMENT) +
           round_up(values, VALUES_ALIGNMENT);
}

struct node_sums *node_sums_new(uint32_t pixel_count, uint32_t channel_count)
{
    assert(pixel_count >= 1 && pixel_count <= TILE_PIXELS);
    size_t size = node_sums_size(pixel_count, channel_count);
    struct node_sums *sums = aligned_alloc(VALUES_ALIGNMENT, size);
    if (sums == NULL)
        return NULL;
    memset(sums, 0, size);
    sums->pixel_count = pixel_count;
    sums->channel_count = channel_count;
    sums->values = (float *)((char *)sums + round_up(sizeof(*sums), VALUES_ALIGNMENT));
    return sums;
}

void node_sums_free(struct node_sums *sums)
{
    free(sums);
}

void node_stats_add(struct node_stats *left, const struct node_stats *right)
{
    left->samples += right->samples;
    left->rays_closest += right->rays_closest;
    left->rays_shadow += right->rays_shadow;
    left->events += right->events;
    for (int cause = 0; cause < NONFINITE_CAUSES; cause++)
        left->nonfinite[cause] += right->nonfinite[cause];
    left->truncated_paths += right->truncated_paths;
    left->truncated_energy += right->truncated_energy;
    if (right->largest > left->largest)
        left->largest = right->largest;
}

void node_sums_add(struct node_sums *left, const struct node_sums *right)
{
    assert(left->pixel_count == right->pixel_count);
    assert(left->channel_count == right->channel_count);

    node_stats_add(&left->stats, &right->stats);
    for (unsigned word = 0; word < TILE_PIXELS / 32; word++)
        left->failed[word] |= right->failed[word];

    size_t count = (size_t)left->pixel_count * left->channel_count;
    float *restrict to = left->values;
    const float *restrict from = right->values;
    for (size_t i = 0; i < count; i++)
        to[i] += from[i];
}

/*
 * Rounds come in groups of eight. The first group has nodes of level 0 and index 0..7; group
 * g >= 1 has nodes of level g - 1 and index 8..15, which carry on where the group before ended.
 */
void round_node(unsigned round, uint32_t *level, uint64_t *index)
{
    assert(round < ROUND_COUNT);
    unsigned group = round / 8;
    *level = group == 0 ? 0 : group - 1;
    *index = group == 0 ? round : 8 + round % 8;
}

uint64_t round_end(unsigned round)
{
    uint32_t level;
    uint64_t index;
    round_node(round, &level, &index);
    return (index + 1) << level;
}

unsigned round_reaching(uint64_t leaves)
{
    assert(leaves <= (uint64_t)1 << NODE_LEVEL_MAX);
    if (leaves <= 8)
        return leaves == 0 ? 0 : (unsigned)leaves - 1;
    uint64_t last = leaves - 1;
    unsigned level = 60 - (unsigned)__builtin_clzll(last); /* brings `last` to 8..15 */
    return 8 * level + (unsigned)(last >> level);
}

bool round_holding(uint32_t level, uint64_t index, unsigned *round)
{
    if (level > NODE_LEVEL_MAX || index >= (uint64_t)1 << (NODE_LEVEL_MAX - level))
        return false;
    unsigned candidate = round_reaching((index << level) + 1);
    uint32_t round_level;
    uint64_t round_index;
    round_node(candidate, &round_level, &round_index);
    if (level > round_level)
        return false;
    *round = candidate;
    return true;
}

/* A node that waits for its sibling */
struct waiting {
    uint64_t index;
    uint32_t level;
    struct node_sums *sums;
};

struct fold {
    uint32_t level;
    uint64_t index;
    struct waiting *waiting; /* disjoint, in leaf order */
    size_t count, capacity;
};

struct fold *fold_new(uint32_t target_level, uint64_t target_index)
{
    assert(target_level <= NODE_LEVEL_MAX);
    assert(target_index < (uint64_t)1 << (NODE_LEVEL_MAX - target_level));
    struct fold *fold = calloc(1, sizeof(*fold));
    if (fold == NULL)
        return NULL;
    fold->level = target_level;
    fold->index = target_index;
    return fold;
}

void fold_free(struct fold *fold)
{
    if (fold == NULL)
        return;
    for (size_t i = 0; i < fold->count; i++)
        node_sums_free(fold->waiting[i].sums);
    free(fold->waiting);
    free(fold);
}

/* The first waiting node that does not end before `leaf`. */
static size_t first_not_before(const struct fold *fold, uint64_t leaf)
{
    size_t low = 0, high = fold->count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        const struct waiting *w = &fold->waiting[middle];
        if ((w->index + 1) << w->level <= leaf)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

enum fold_result fold_check(const struct fold *fold, uint32_t level, uint64_t index)
{
    if (level > fold->level || index >> (fold->level - level) != fold->index)
        return FOLD_FOREIGN;
    size_t at = first_not_before(fold, index << level);
    if (at == fold->count)
        return FOLD_ADDED;
    const struct waiting *next = &fold->waiting[at];
    return next->index << next->level < (index + 1) << level ? FOLD_DUPLICATE : FOLD_ADDED;
}

static bool fold_reserve(struct fold *fold)
{
    if (fold->count < fold->capacity)
        return true;
    size_t capacity = fold->capacity == 0 ? 4 : 2 * fold->capacity;
    struct waiting *grown = realloc(fold->waiting, capacity * sizeof(*grown));
    if (grown == NULL)
        return false;
    fold->waiting = grown;
    fold->capacity = capacity;
    return true;
}

static bool are_siblings(const struct waiting *left, const struct waiting *right)
{
    return left->level == right->level && left->index % 2 == 0 && right->index == left->index + 1;
}

/* Replace the siblings at `at` and `at + 1` by their parent. */
static void fold_join(struct fold *fold, size_t at)
{
    struct waiting *left = &fold->waiting[at];
    struct waiting *right = left + 1;
    node_sums_add(left->sums, right->sums);
    node_sums_free(right->sums);
    left->level++;
    left->index /= 2;
    memmove(right, right + 1, (fold->count - at - 2) * sizeof(*right));
    fold->count--;
}

enum fold_result fold_add(struct fold *fold, uint32_t level, uint64_t index, struct node_sums *sums)
{
    enum fold_result verdict = fold_check(fold, level, index);
    if (verdict != FOLD_ADDED)
        return verdict;
    if (!fold_reserve(fold))
        return FOLD_NO_MEMORY;

    size_t at = first_not_before(fold, index << level);
    struct waiting *slot = &fold->waiting[at];
    memmove(slot + 1, slot, (fold->count - at) * sizeof(*slot));
    *slot = (struct waiting){ .index = index, .level = level, .sums = sums };
    fold->count++;

    /* A join may complete the pair one level up. The target itself has no sibling below it. */
    for (;;) {
        struct waiting *node = &fold->waiting[at];
        if (node->level == fold->level)
            break;
        if (at + 1 < fold->count && are_siblings(node, node + 1))
            fold_join(fold, at);
        else if (at > 0 && are_siblings(node - 1, node))
            fold_join(fold, --at);
        else
            break;
    }
    return FOLD_ADDED;
}

struct node_sums *fold_take(struct fold *fold)
{
    if (fold->count != 1 || fold->waiting[0].level != fold->level)
        return NULL;
    fold->count = 0;
    return fold->waiting[0].sums;
}

size_t fold_waiting(const struct fold *fold)
{
    return fold->count;
}

void sum_stack_push(struct sum_stack *stack, uint32_t level, struct node_sums *sums)
{
    assert(level <= NODE_LEVEL_MAX);
    assert((stack->leaves & (((uint64_t)1 << level) - 1)) == 0);
    stack->leaves += (uint64_t)1 << level;
    for (; stack->sums[level] != NULL; level++) {
        assert(level < NODE_LEVEL_MAX);
        struct node_sums *left = stack->sums[level];
        stack->sums[level] = NULL;
        node_sums_add(left, sums);
        node_sums_free(sums);
        sums = left;
    }
    stack->sums[level] = sums;
}

static void node_sums_copy(struct node_sums *to, const struct node_sums *from)
{
    assert(to->pixel_count == from->pixel_count && to->channel_count == from->channel_count);
    float *values = to->values;
    *to = *from;
    to->values = values;
    memcpy(values, from->values, (size_t)from->pixel_count * from->channel_count * sizeof(*values));
}

static void node_sums_zero(struct node_sums *sums)
{
    memset(&sums->stats, 0, sizeof(sums->stats));
    memset(sums->failed, 0, sizeof(sums->failed));
    memset(sums->values, 0,
           (size_t)sums->pixel_count * sums->channel_count * sizeof(*sums->values));
}

void sum_stack_total(const struct sum_stack *stack, struct node_sums *total)
{
    bool empty = true;
    for (unsigned level = 0; level <= NODE_LEVEL_MAX; level++) {
        if (stack->sums[level] == NULL)
            continue;
        if (empty)
            node_sums_copy(total, stack->sums[level]);
        else
            node_sums_add(total, stack->sums[level]);
        empty = false;
    }
    if (empty)
        node_sums_zero(total);
}

void sum_stack_clear(struct sum_stack *stack)
{
    for (unsigned level = 0; level <= NODE_LEVEL_MAX; level++)
        node_sums_free(stack->sums[level]);
    memset(stack, 0, sizeof(*stack));
}
