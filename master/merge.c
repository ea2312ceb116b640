#include "master/merge.h"

#include "common/aov.h"
#include "common/err.h"
#include "master/cryptomatte.h"
#include "master/image.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum kind { MEAN, ERROR, SAMPLES, HIT, IDENTITY };

/* What a channel is, by the beginning of its name. */
static const struct {
    const char *begins;
    enum kind kind;
} KINDS[] = {
    { "stderr.", ERROR },
    { "samples", SAMPLES },
    { "depth.", HIT },
    { "position.", HIT },
    { "normal.", HIT },
    { "geometric_normal.", HIT },
    { "albedo.", HIT },
    { "motion.", HIT },
    { "CryptoObject", IDENTITY },
    { "CryptoMaterial", IDENTITY },
};

static const char *const CRYPTOMATTES[] = { "CryptoObject", "CryptoMaterial" };
#define CRYPTOMATTE_COUNT 2

struct identity {
    float id;
    float weight; /* coverage times the weight of its picture, added up */
};

struct merge {
    uint32_t count;
    struct image *first;                     /* the first picture without its values */
    enum kind *kinds;                        /* of its channels */
    double *sums;                            /* [channel][pixel] */
    double *hits;                            /* [pixel]: weights of the averages over hits */
    double *counted;                         /* [pixel]: samples that identities count */
    struct identity *ids[CRYPTOMATTE_COUNT]; /* [pixel][MERGE_IDS] */
    char **seeds;
    size_t seed_count;
    uint64_t spp, replicates;
    double core_s;                /* NaN: not all say it */
    double error2, error4_by_dof; /* the sums of Satterthwaite's formula, times (sum of n)^2, ^4 */
    bool complete, same_profile;
};

struct merge *merge_new(void)
{
    return calloc(1, sizeof(struct merge));
}

void merge_free(struct merge *m)
{
    if (m == NULL)
        return;
    image_free(m->first);
    free(m->kinds);
    free(m->sums);
    free(m->hits);
    free(m->counted);
    for (int i = 0; i < CRYPTOMATTE_COUNT; i++)
        free(m->ids[i]);
    for (size_t i = 0; i < m->seed_count; i++)
        free(m->seeds[i]);
    free(m->seeds);
    free(m);
}

/* ---- what a picture says of itself */

/* What is needed of its metadata; texts are the image's. */
struct facts {
    const char *scene, *seeds, *profile;
    uint64_t spp, replicates;
    double dof, core_s;
    bool complete;
};

static bool read_facts(const struct image *image, const char *name, struct facts *facts,
                       struct err *err)
{
    const char *seed = image_attribute(image, "pathfarm.seed");
    const char *spp = image_attribute(image, "pathfarm.spp");
    const char *replicates = image_attribute(image, "pathfarm.replicates");
    const char *dof = image_attribute(image, "pathfarm.stderrDof");
    const char *core_s = image_attribute(image, "pathfarm.coreSeconds");
    const char *complete = image_attribute(image, "pathfarm.complete");
    *facts = (struct facts){
        .scene = image_attribute(image, "pathfarm.sceneDigest"),
        .seeds = seed != NULL ? seed : image_attribute(image, "pathfarm.seeds"),
        .profile = image_attribute(image, "pathfarm.profile"),
        .core_s = core_s == NULL ? NAN : strtod(core_s, NULL),
        .complete = complete != NULL && strcmp(complete, "yes") == 0,
    };
    if (facts->scene == NULL || facts->seeds == NULL || spp == NULL || replicates == NULL ||
        dof == NULL)
        return err_set(err, ERR_ARGUMENT,
                       "%s: its metadata do not tell scene, seed, samples and replicates; only "
                       "pictures that pathfarm rendered can be merged",
                       name);
    facts->spp = strtoull(spp, NULL, 10);
    facts->replicates = strtoull(replicates, NULL, 10);
    facts->dof = strtod(dof, NULL);
    return true;
}

static bool same_text(const char *a, const char *b)
{
    return a != NULL && b != NULL && strcmp(a, b) == 0;
}

static bool check_shape(const struct merge *m, const struct image *image, const struct facts *facts,
                        const char *name, struct err *err)
{
    const struct image *first = m->first;
    if (!same_text(facts->scene, image_attribute(first, "pathfarm.sceneDigest")))
        return err_set(err, ERR_ARGUMENT,
                       "%s: another scene, or another camera, size, sampler or depth, than the "
                       "first picture's (their scene digests differ)",
                       name);
    if (image->display_width != first->display_width ||
        image->display_height != first->display_height)
        return err_set(err, ERR_ARGUMENT,
                       "%s: %" PRIu32 "x%" PRIu32 " pixels, not %" PRIu32 "x%" PRIu32, name,
                       image->display_width, image->display_height, first->display_width,
                       first->display_height);
    if (image->width != first->width || image->height != first->height ||
        image->data_x != first->data_x || image->data_y != first->data_y)
        return err_set(err, ERR_ARGUMENT, "%s: another crop window than the first picture's", name);
    for (uint32_t c = 0; c < first->channel_count; c++)
        if (image_channel(image, first->channels[c].name) == NULL)
            return err_set(err, ERR_ARGUMENT, "%s: no channel %s, which the first picture has",
                           name, first->channels[c].name);
    for (uint32_t c = 0; c < image->channel_count; c++)
        if (image_channel(first, image->channels[c].name) == NULL)
            return err_set(err, ERR_ARGUMENT, "%s: a channel %s, which the first picture lacks",
                           name, image->channels[c].name);
    return true;
}

/* A copy of the seeds of a picture, "1" or "1,2,3", one after the other; NULL after the last. */
static char *next_seed(const char **seeds)
{
    size_t length = strcspn(*seeds, ",");
    char *seed = length == 0 ? NULL : strndup(*seeds, length);
    *seeds += length + ((*seeds)[length] == ',');
    return seed;
}

static bool add_seeds(struct merge *m, const char *seeds, const char *name, struct err *err)
{
    size_t before = m->seed_count;
    for (char *seed; (seed = next_seed(&seeds)) != NULL;) {
        char **more = reallocarray(m->seeds, m->seed_count + 1, sizeof(*more));
        if (more == NULL) {
            free(seed);
            err_set(err, ERR_MEMORY, "out of memory");
            goto fail;
        }
        m->seeds = more;
        m->seeds[m->seed_count++] = seed;
        for (size_t i = 0; i + 1 < m->seed_count; i++)
            if (strcmp(m->seeds[i], seed) == 0) {
                err_set(err, ERR_ARGUMENT,
                        "%s: seed %s was merged already: the same samples must not count twice",
                        name, seed);
                goto fail;
            }
    }
    return true;

fail:
    while (m->seed_count > before)
        free(m->seeds[--m->seed_count]);
    return false;
}

/* ---- beginning, with the first picture */

static bool kind_of(const char *channel, enum kind *kind)
{
    for (size_t i = 0; i < sizeof(KINDS) / sizeof(KINDS[0]); i++)
        if (strncmp(channel, KINDS[i].begins, strlen(KINDS[i].begins)) == 0) {
            *kind = KINDS[i].kind;
            return true;
        }
    *kind = MEAN;
    return strlen(channel) == 1 && strchr("RGBA", channel[0]) != NULL;
}

static bool copy_attributes(const struct image *from, struct image *to)
{
    for (uint32_t i = 0; i < from->attribute_count; i++)
        if (!image_set_attribute(to, from->attributes[i].name, from->attributes[i].text))
            return false;
    return true;
}

/* Of a picture in which this or that is missing, nothing is begun. */
static bool begin(struct merge *m, const struct image *image, const char *name, struct err *err)
{
    static const char *const NEEDED[] = { "R",        "G",        "B",      "stderr.R",
                                          "stderr.G", "stderr.B", "samples" };
    for (size_t i = 0; i < sizeof(NEEDED) / sizeof(NEEDED[0]); i++)
        if (image_channel(image, NEEDED[i]) == NULL)
            return err_set(err, ERR_ARGUMENT, "%s: no channel %s", name, NEEDED[i]);
    for (uint32_t c = 0; c < image->channel_count; c++) {
        enum kind kind;
        if (!kind_of(image->channels[c].name, &kind))
            return err_set(err, ERR_ARGUMENT, "%s: nobody knows how to merge channels %s", name,
                           image->channels[c].name);
    }

    size_t pixels = (size_t)image->width * image->height;
    m->first = image_new(image->width, image->height);
    m->kinds = calloc(image->channel_count, sizeof(*m->kinds));
    m->sums = calloc(image->channel_count * pixels, sizeof(*m->sums));
    m->hits = calloc(pixels, sizeof(*m->hits));
    m->counted = calloc(pixels, sizeof(*m->counted));
    bool enough = m->first != NULL && m->kinds != NULL && m->sums != NULL && m->hits != NULL &&
                  m->counted != NULL && copy_attributes(image, m->first);
    for (uint32_t c = 0; c < image->channel_count && enough; c++) {
        kind_of(image->channels[c].name, &m->kinds[c]);
        enough = image_add_channel(m->first, image->channels[c].name) != NULL;
    }
    for (int i = 0; i < CRYPTOMATTE_COUNT && enough; i++) {
        char channel[32];
        cryptomatte_channel(CRYPTOMATTES[i], 0, channel, sizeof(channel));
        if (image_channel(image, channel) == NULL)
            continue;
        m->ids[i] = calloc(pixels * MERGE_IDS, sizeof(*m->ids[i]));
        enough = m->ids[i] != NULL;
    }
    if (!enough)
        return err_set(err, ERR_MEMORY, "no memory to merge pictures in");
    m->first->data_x = image->data_x;
    m->first->data_y = image->data_y;
    m->first->display_width = image->display_width;
    m->first->display_height = image->display_height;
    m->complete = m->same_profile = true;
    return true;
}

/* ---- adding */

/* By falling weight, and rising identity where they cover as much. */
static int by_weight(const void *a, const void *b)
{
    const struct identity *x = a, *y = b;
    if (x->weight != y->weight)
        return x->weight < y->weight ? 1 : -1;
    return (x->id > y->id) - (x->id < y->id);
}

/* The identities of one pixel and of one picture into the list so far. */
static void add_identities(struct identity list[MERGE_IDS],
                           const float *const planes[2 * CRYPTOMATTE_RANKS], size_t p,
                           double weight)
{
    struct identity all[MERGE_IDS + CRYPTOMATTE_RANKS] = { { 0, 0 } };
    unsigned count = 0;
    while (count < MERGE_IDS && list[count].weight > 0) {
        all[count] = list[count];
        count++;
    }
    for (int rank = 0; rank < CRYPTOMATTE_RANKS; rank++) {
        float id = planes[2 * rank][p], coverage = planes[2 * rank + 1][p];
        if (!(coverage > 0))
            continue;
        unsigned at = 0;
        while (at < count && all[at].id != id)
            at++;
        all[at].id = id;
        all[at].weight += (float)weight * coverage;
        count += at == count;
    }
    qsort(all, count, sizeof(all[0]), by_weight);
    memcpy(list, all, MERGE_IDS * sizeof(all[0]));
}

static void add_cryptomatte(struct merge *m, int which, const struct image *image,
                            const float *samples, double most)
{
    const float *planes[2 * CRYPTOMATTE_RANKS];
    for (unsigned i = 0; i < 2 * CRYPTOMATTE_RANKS; i++) {
        char channel[32];
        cryptomatte_channel(CRYPTOMATTES[which], i, channel, sizeof(channel));
        planes[i] = image_channel(image, channel);
        if (planes[i] == NULL)
            return; /* not all ranks: nothing that pathfarm writes */
    }
    for (size_t p = 0; p < (size_t)image->width * image->height; p++)
        add_identities(m->ids[which] + p * MERGE_IDS, planes, p, fmin(samples[p], most));
}

/* The weight of a pixel in averages over hits. */
static double hit_weight(const struct merge *m, const float *const values[], const float *alpha,
                         double samples, size_t p)
{
    bool hit = false;
    for (uint32_t c = 0; c < m->first->channel_count && !hit; c++)
        hit = m->kinds[c] == HIT && values[c][p] != 0;
    if (!hit)
        return 0;
    return alpha != NULL && alpha[p] > 0 ? samples * (double)alpha[p] : samples;
}

static void add_pixels(struct merge *m, const struct image *image, const float *const values[],
                       const struct facts *facts)
{
    const float *samples = image_channel(image, "samples"), *alpha = image_channel(image, "A");
    size_t pixels = (size_t)image->width * image->height;
    double most = (double)AOV_ID_SAMPLES * (double)facts->replicates, error2 = 0;
    for (size_t p = 0; p < pixels; p++) {
        double n = samples[p], hit = hit_weight(m, values, alpha, n, p);
        m->hits[p] += hit;
        m->counted[p] += fmin(n, most);
        for (uint32_t c = 0; c < m->first->channel_count; c++) {
            double value = values[c][p], *sum = &m->sums[c * pixels + p];
            switch (m->kinds[c]) {
            case MEAN:
                *sum += n * value;
                break;
            case ERROR:
                *sum += n * n * value * value;
                error2 += isfinite(value) ? n * n * value * value : 0;
                break;
            case SAMPLES:
                *sum += n;
                break;
            case HIT:
                *sum += hit * value;
                break;
            case IDENTITY:
                break;
            }
        }
    }
    for (int i = 0; i < CRYPTOMATTE_COUNT; i++)
        if (m->ids[i] != NULL)
            add_cryptomatte(m, i, image, samples, most);
    m->error2 += error2;
    if (facts->dof > 0)
        m->error4_by_dof += error2 * error2 / facts->dof;
}

bool merge_add(struct merge *m, const struct image *image, const char *name, struct err *err)
{
    struct facts facts;
    if (!read_facts(image, name, &facts, err))
        return false;
    if (m->count == 0 ? !begin(m, image, name, err) : !check_shape(m, image, &facts, name, err))
        return false;
    const float **values = calloc(m->first->channel_count, sizeof(*values));
    if (values == NULL)
        return err_set(err, ERR_MEMORY, "no memory to merge pictures in");
    if (!add_seeds(m, facts.seeds, name, err)) {
        free(values);
        return false;
    }
    for (uint32_t c = 0; c < m->first->channel_count; c++)
        values[c] = image_channel(image, m->first->channels[c].name);
    add_pixels(m, image, values, &facts);
    free(values);
    m->count++;
    m->spp += facts.spp;
    m->replicates += facts.replicates;
    m->core_s += facts.core_s;
    m->complete = m->complete && facts.complete;
    m->same_profile = m->same_profile &&
                      same_text(facts.profile, image_attribute(m->first, "pathfarm.profile"));
    return true;
}

/* ---- the result */

static void take_pixels(const struct merge *m, struct image *image)
{
    size_t pixels = (size_t)image->width * image->height;
    const double *total = NULL;
    for (uint32_t c = 0; c < image->channel_count; c++)
        if (m->kinds[c] == SAMPLES)
            total = m->sums + c * pixels;
    assert(total != NULL);
    for (uint32_t c = 0; c < image->channel_count; c++) {
        const double *sum = m->sums + c * pixels;
        float *values = image->channels[c].values;
        for (size_t p = 0; p < pixels; p++) {
            switch (m->kinds[c]) {
            case MEAN:
                values[p] = total[p] > 0 ? (float)(sum[p] / total[p]) : 0;
                break;
            case ERROR:
                values[p] = total[p] > 0 ? (float)(sqrt(sum[p]) / total[p]) : INFINITY;
                break;
            case SAMPLES:
                values[p] = (float)sum[p];
                break;
            case HIT:
                values[p] = m->hits[p] > 0 ? (float)(sum[p] / m->hits[p]) : 0;
                break;
            case IDENTITY:
                break;
            }
        }
    }
}

static void take_cryptomatte(const struct merge *m, int which, struct image *image)
{
    for (unsigned rank = 0; rank < CRYPTOMATTE_RANKS; rank++) {
        char channel[2][32];
        cryptomatte_channel(CRYPTOMATTES[which], 2 * rank, channel[0], sizeof(channel[0]));
        cryptomatte_channel(CRYPTOMATTES[which], 2 * rank + 1, channel[1], sizeof(channel[1]));
        float *ids = image_channel(image, channel[0]),
              *coverages = image_channel(image, channel[1]);
        if (ids == NULL || coverages == NULL)
            return;
        for (size_t p = 0; p < (size_t)image->width * image->height; p++) {
            const struct identity *identity = &m->ids[which][p * MERGE_IDS + rank];
            ids[p] = identity->weight > 0 ? identity->id : 0;
            coverages[p] = identity->weight > 0 ? (float)((double)identity->weight / m->counted[p])
                                                : 0;
        }
    }
}

static bool note_seeds(const struct merge *m, struct image *image)
{
    char *text = NULL;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    if (out == NULL)
        return false;
    for (size_t i = 0; i < m->seed_count; i++)
        fprintf(out, "%s%s", i == 0 ? "" : ",", m->seeds[i]);
    bool done = fclose(out) == 0 && image_set_attribute(image, "pathfarm.seeds", text);
    free(text);
    return done;
}

/* Of the first picture's attributes those that are true of the whole. Others may be the file
 * format's own, which its writer must set. */
static bool take_facts(const struct merge *m, struct image *image, const char *command,
                       const char *build)
{
    static const char cryptomatte[] = "cryptomatte/";
    const struct image *first = m->first;
    for (uint32_t i = 0; i < first->attribute_count; i++) {
        const struct image_attribute *a = &first->attributes[i];
        bool kept = strncmp(a->name, cryptomatte, strlen(cryptomatte)) == 0 ||
                    strcmp(a->name, "pathfarm.sceneDigest") == 0 ||
                    (strcmp(a->name, "pathfarm.profile") == 0 && m->same_profile);
        if (kept && !image_set_attribute(image, a->name, a->text))
            return false;
    }
    double dof = m->error4_by_dof > 0 ? m->error2 * m->error2 / m->error4_by_dof : 0;
    return image_set_attribute(image, "pathfarm.command", command) &&
           image_set_attribute(image, "pathfarm.build", build) && note_seeds(m, image) &&
           image_note(image, "pathfarm.merged", "%" PRIu32, m->count) &&
           image_note(image, "pathfarm.spp", "%" PRIu64, m->spp) &&
           image_note(image, "pathfarm.replicates", "%" PRIu64, m->replicates) &&
           image_note(image, "pathfarm.stderrDof", "%.6g", dof) &&
           image_note(image, "pathfarm.complete", m->complete ? "yes" : "no") &&
           (isnan(m->core_s) || image_note(image, "pathfarm.coreSeconds", "%.9g", m->core_s));
}

struct image *merge_take(struct merge *m, const char *command, const char *build, struct err *err)
{
    assert(m->count > 0);
    struct image *image = image_new(m->first->width, m->first->height);
    bool enough = image != NULL;
    for (uint32_t c = 0; c < m->first->channel_count && enough; c++)
        enough = image_add_channel(image, m->first->channels[c].name) != NULL;
    if (!enough || !take_facts(m, image, command, build)) {
        image_free(image);
        err_set(err, ERR_MEMORY, "no memory for the merged picture");
        return NULL;
    }
    image->data_x = m->first->data_x;
    image->data_y = m->first->data_y;
    image->display_width = m->first->display_width;
    image->display_height = m->first->display_height;
    take_pixels(m, image);
    for (int i = 0; i < CRYPTOMATTE_COUNT; i++)
        if (m->ids[i] != NULL)
            take_cryptomatte(m, i, image);
    return image;
}
