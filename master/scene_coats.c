#include "master/scene_coats.h"

#include "common/err.h"
#include "common/scene.h"
#include "common/sheen.h"
#include "master/coat.h"
#include "master/scene_build.h"

#include <math.h>
#include <string.h>

#define ROWS_EXACT 192 /* of tables, while every coat gets its own */
#define ROWS_MOST  256 /* after so many, the nearest serve */
#define ROOT_STEPS 32  /* widths between them: their square roots, in steps */

/* What the tables of a coat depend on, and where they are */
struct known_coat {
    uint32_t kind, flags;
    float ior, alpha, base_alpha; /* the means of both axes */
    double thickness;
    uint32_t table; /* first row among the scene's */
    float inner, scale;
};

void scene_coats_free(struct scene_coats *coats)
{
    growing_free(&coats->known);
}

static size_t row_count(const struct known_coat *coat)
{
    return coat->kind == MATERIAL_COAT ? 1 : COAT_METAL_ROWS;
}

/* The rows of one width, with the two numbers that belong to them */
static void tabulate(const struct known_coat *of, double alpha, float *rows, float *inner,
                     float *scale)
{
    if (of->kind == MATERIAL_COAT) {
        struct coat coat;
        coat_tabulate(alpha, (double)of->ior, of->thickness, &coat);
        memcpy(rows, coat.table, sizeof(coat.table));
        *inner = coat.inner;
        *scale = coat.scale;
    } else {
        struct coat_metal coat;
        coat_metal_tabulate(alpha, (double)of->base_alpha, (double)of->ior, of->thickness, &coat);
        memcpy(rows, coat.rows, sizeof(coat.rows));
        *inner = coat.inner;
        *scale = coat.scale;
    }
}

static bool add_rows(struct growing *tables, struct known_coat *coat)
{
    bool many = coat->flags & MATERIAL_COATS;
    size_t rows = row_count(coat), length = rows * COAT_TABLE_LEN;
    coat->table = (uint32_t)tables->count;
    float *table = growing_add(tables, many ? rows * COAT_ALPHAS + 1 : rows,
                               COAT_TABLE_LEN * sizeof(float));
    if (table == NULL)
        return false;
    if (!many) {
        tabulate(coat, (double)coat->alpha, table, &coat->inner, &coat->scale);
        return true;
    }
    float *last = table + length * COAT_ALPHAS;
    memset(last, 0, COAT_TABLE_LEN * sizeof(float));
    for (int j = 0; j < COAT_ALPHAS; j++) {
        double root = (double)j / (COAT_ALPHAS - 1);
        float scale;
        tabulate(coat, root * root, table + (size_t)j * length, last + j, &scale);
        last[COAT_ALPHAS + j] = scale > 0 ? 1 / scale : 0;
        coat->scale = j == 0 ? scale : coat->scale;
    }
    coat->inner = last[0];
    return true;
}

static bool same(const struct known_coat *a, const struct known_coat *b)
{
    return a->kind == b->kind && a->flags == b->flags && a->ior == b->ior && a->alpha == b->alpha &&
           a->base_alpha == b->base_alpha && a->thickness == b->thickness;
}

static struct known_coat *find(const struct scene_coats *coats, const struct known_coat *wanted)
{
    struct known_coat *known = coats->known.data;
    for (size_t i = 0; i < coats->known.count; i++)
        if (same(&known[i], wanted))
            return &known[i];
    return NULL;
}

static float apart(const struct known_coat *a, const struct known_coat *b)
{
    return fabsf(a->ior - b->ior) + fabsf(a->alpha - b->alpha) +
           fabsf(a->base_alpha - b->base_alpha);
}

static float to_step(float alpha)
{
    float root = floorf(sqrtf(alpha) * ROOT_STEPS + 0.5f) / ROOT_STEPS;
    return root * root;
}

/* A row takes a millisecond. A scene of hundreds of coats shares the tables of similar widths, and,
 * beyond reason, whatever is nearest; the widths of the lobes themselves stay exact. */
static void share(const struct scene_coats *coats, size_t rows, struct known_coat *wanted)
{
    const struct known_coat *known = coats->known.data, *nearest = NULL;
    if (rows < ROWS_EXACT)
        return;
    wanted->alpha = to_step(wanted->alpha);
    wanted->base_alpha = to_step(wanted->base_alpha);
    if (rows < ROWS_MOST || find(coats, wanted) != NULL)
        return;
    for (size_t i = 0; i < coats->known.count; i++)
        if (known[i].kind == wanted->kind && known[i].flags == wanted->flags &&
            (nearest == NULL || apart(&known[i], wanted) < apart(nearest, wanted)))
            nearest = &known[i];
    if (nearest != NULL)
        *wanted = *nearest;
}

bool scene_coats_add(struct scene_coats *coats, struct scene_build *build,
                     struct material *material, double thickness, struct err *err)
{
    if (material->texture[SLOT_ROUGHNESS_U] != 0 || material->texture[SLOT_ROUGHNESS_V] != 0)
        material->flags |= MATERIAL_COATS;
    bool many = material->flags & MATERIAL_COATS;
    struct known_coat wanted = {
        .kind = material->kind,
        .flags = material->flags & MATERIAL_COATS,
        .ior = material->ior,
        .alpha = many ? 0 : (material->alpha[0] + material->alpha[1]) / 2,
        .base_alpha = (material->base_alpha[0] + material->base_alpha[1]) / 2,
        .thickness = thickness,
    };
    struct known_coat *coat = find(coats, &wanted);
    coats->similar = false;
    if (coat == NULL) {
        const struct known_coat exact = wanted;
        share(coats, build->coat_tables.count - (coats->sheen != 0 ? SHEEN_ROWS : 0), &wanted);
        coats->similar = !same(&exact, &wanted);
        coat = find(coats, &wanted);
    }
    if (coat == NULL) {
        if (!add_rows(&build->coat_tables, &wanted) ||
            (coat = growing_add(&coats->known, 1, sizeof(*coat))) == NULL)
            return err_set(err, ERR_MEMORY, "no memory for the tables of a coat");
        *coat = wanted;
    }
    material->coat_table = coat->table;
    material->coat_inner = coat->inner;
    material->coat_scale = coat->scale;
    return true;
}

bool scene_coats_add_sheen(struct scene_coats *coats, struct scene_build *build,
                           struct material *material, const double color[3], double alpha,
                           struct err *err)
{
    if (coats->sheen == 0) {
        float(*rows)[COAT_TABLE_LEN] = growing_add(&build->coat_tables, SHEEN_ROWS, sizeof(*rows));
        if (rows == NULL)
            return err_set(err, ERR_MEMORY, "no memory for the table of a sheen");
        sheen_tabulate(rows);
        coats->sheen = (uint32_t)(build->coat_tables.count - SHEEN_ROWS + 1);
    }
    material->flags |= MATERIAL_SHEEN;
    material->sheen_table = coats->sheen - 1;
    material->sheen_alpha = fminf(fmaxf((float)alpha, SHEEN_ALPHA_LEAST), 1);
    for (int c = 0; c < 3; c++)
        material->sheen[c] = (float)color[c];
    return true;
}
