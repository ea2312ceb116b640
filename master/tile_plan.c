#include "master/tile_plan.h"

#include "common/job.h"
#include "common/scene.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#define NEIGHBOUR_SHARE 0.25 /* of the mean error around a tile: it counts for at least that */
#define OPEN_END_LEAVES 512  /* per replicate, where nobody knows how many rounds there will be */
#define LEAST_RATE      1e-6 /* of the largest: a tile without error gets only what is left over */

struct tile_plan tile_plan_uniform(uint32_t tiles, uint32_t replicates)
{
    return (struct tile_plan){
        .tiles = tiles, .across = tiles, .replicates = replicates, .made = true, .predicted_gain = 1
    };
}

bool tile_plan_open(struct tile_plan *plan, const struct scene *scene, const struct job_spec *spec)
{
    const uint32_t *crop = scene->settings.crop;
    *plan = tile_plan_uniform(tile_count(scene), spec->replicates);
    plan->across = (crop[1] - crop[0] + TILE_SIZE - 1) / TILE_SIZE;
    plan->pilot_rounds = spec->pilot_rounds;
    plan->pilot_weight = job_pilot_weight(spec);
    plan->made = spec->pilot_rounds == 0;
    if (plan->made)
        return true;
    plan->octaves = calloc(plan->tiles, sizeof(*plan->octaves));
    plan->looks = calloc(plan->tiles, sizeof(*plan->looks));
    return plan->octaves != NULL && plan->looks != NULL;
}

void tile_plan_close(struct tile_plan *plan)
{
    free(plan->octaves);
    free(plan->looks);
    plan->octaves = NULL;
    plan->looks = NULL;
}

uint32_t tile_plan_sequences(const struct tile_plan *plan)
{
    return plan->pilot_rounds == 0 ? plan->replicates : 2 * plan->replicates;
}

/* ---- factors */

static double factor_of(int octave)
{
    return octave >= 0 ? (double)(1 << octave) : 1 / (double)(1 << -octave);
}

/* The largest octave whose factor is not above this one, within the limits. */
static int octave_below(double factor)
{
    int octave = TILE_PLAN_OCTAVE_MIN;
    while (octave < TILE_PLAN_OCTAVE_MAX && factor_of(octave + 1) <= factor)
        octave++;
    return octave;
}

static int octave_of(const struct tile_plan *plan, uint32_t tile)
{
    return plan->octaves == NULL ? 0 : plan->octaves[tile];
}

double tile_plan_factor(const struct tile_plan *plan, uint32_t tile)
{
    return factor_of(octave_of(plan, tile));
}

uint32_t tile_plan_count_from(const struct tile_plan *plan, int octave)
{
    uint32_t count = 0;
    for (uint32_t tile = 0; tile < plan->tiles; tile++)
        count += octave_of(plan, tile) >= octave;
    return count;
}

uint32_t tile_plan_count_to(const struct tile_plan *plan, int octave)
{
    uint32_t count = 0;
    for (uint32_t tile = 0; tile < plan->tiles; tile++)
        count += octave_of(plan, tile) <= octave;
    return count;
}

/* ---- rounds */

/* Own rounds of a main sequence when `rounds` rounds beyond the pilot's are done. */
static unsigned main_rounds(int octave, unsigned rounds)
{
    const uint64_t most = (uint64_t)1 << NODE_LEVEL_MAX;
    if (rounds == 0 || octave == 0)
        return rounds;
    uint64_t leaves = round_end(rounds - 1);
    leaves = octave > 0 ? leaves << octave : leaves >> -octave;
    return round_reaching(leaves < 1 ? 1 : leaves > most ? most : leaves) + 1;
}

unsigned tile_plan_pair_rounds(const struct tile_plan *plan, uint32_t tile, uint32_t sequence,
                               unsigned rounds)
{
    unsigned pilot = rounds < plan->pilot_rounds ? rounds : plan->pilot_rounds;
    if (sequence >= plan->replicates)
        return pilot;
    return main_rounds(octave_of(plan, tile), rounds - pilot);
}

bool tile_plan_job_round(const struct tile_plan *plan, const struct node_id *node, unsigned *round)
{
    unsigned own;
    if (node->tile >= plan->tiles || node->replicate >= tile_plan_sequences(plan) ||
        !round_holding(node->level, node->index, &own))
        return false;
    if (node->replicate < plan->replicates && !plan->made)
        return false;
    /* The first after which the pair has finished it: it finishes more and more of them */
    unsigned low = 0, high = ROUND_COUNT;
    while (low < high) {
        unsigned middle = low + (high - low) / 2;
        if (tile_plan_pair_rounds(plan, node->tile, node->replicate, middle + 1) > own)
            high = middle;
        else
            low = middle + 1;
    }
    *round = low;
    return low < ROUND_COUNT;
}

uint64_t tile_plan_units(const struct tile_plan *plan, unsigned round)
{
    uint64_t units = 0;
    if (round < plan->pilot_rounds || plan->octaves == NULL)
        return (uint64_t)plan->tiles * plan->replicates;
    for (uint32_t tile = 0; tile < plan->tiles; tile++)
        units += tile_plan_pair_rounds(plan, tile, 0, round + 1) -
                 tile_plan_pair_rounds(plan, tile, 0, round);
    return units * plan->replicates;
}

static uint64_t leaves_after(unsigned own_rounds)
{
    return own_rounds == 0 ? 0 : round_end(own_rounds - 1);
}

uint64_t tile_plan_leaves(const struct tile_plan *plan, unsigned rounds)
{
    unsigned pilot = rounds < plan->pilot_rounds ? rounds : plan->pilot_rounds;
    uint64_t leaves = leaves_after(pilot) * plan->tiles;
    if (plan->octaves == NULL)
        leaves += leaves_after(rounds - pilot) * plan->tiles;
    else
        for (uint32_t tile = 0; tile < plan->tiles; tile++)
            leaves += leaves_after(main_rounds(plan->octaves[tile], rounds - pilot));
    return leaves * plan->replicates;
}

/* ---- making the plan */

/*
 * Least squares over 192 tiles of seven scenes (Cornell box, glass, glossy, environment, many
 * lights, caustic, soft shadows), processor time of one thread: 190 ns for a closest-hit ray with
 * all that is done where it ends, 380 ns for a shadow ray with the choice of its light. Scattering
 * events and camera paths on top explain no more. What is left is 21 % of a tile's time, some of it
 * the machine's other load.
 */
double tile_plan_work(const struct node_stats *stats)
{
    return (double)stats->rays_closest + 2 * (double)stats->rays_shadow;
}

static double error_density(const struct tile_plan *plan, uint32_t tile)
{
    return plan->looks[tile].error / plan->looks[tile].pixels;
}

/* Error per pixel of a tile, as it counts: see the header. */
static double prudent_density(const struct tile_plan *plan, uint32_t tile)
{
    uint32_t down = plan->tiles / plan->across;
    uint32_t x = tile % plan->across, y = tile / plan->across;
    double own = error_density(plan, tile), sum = 0, count = 0, worst = 0;
    for (uint32_t v = y > 0 ? y - 1 : 0; v <= y + 1 && v < down; v++)
        for (uint32_t u = x > 0 ? x - 1 : 0; u <= x + 1 && u < plan->across; u++) {
            uint32_t other = v * plan->across + u;
            if (other == tile)
                continue;
            double density = error_density(plan, other);
            sum += density;
            count++;
            worst = density > worst ? density : worst;
        }
    if (count == 0)
        return own;
    if (plan->looks[tile].one_sample && own > worst)
        own = worst;
    double around = NEIGHBOUR_SHARE * sum / count;
    return own > around ? own : around;
}

/* The factors that Neyman wants, up to a constant. False when there is no error at all. */
static bool fill_rates(const struct tile_plan *plan, double *rates)
{
    double most = 0;
    for (uint32_t tile = 0; tile < plan->tiles; tile++) {
        const struct tile_look *look = &plan->looks[tile];
        double error = prudent_density(plan, tile) * look->pixels;
        rates[tile] = look->work > 0 ? sqrt(error / look->work) : 0;
        most = rates[tile] > most ? rates[tile] : most;
    }
    if (!(most > 0) || !isfinite(most))
        return false;
    for (uint32_t tile = 0; tile < plan->tiles; tile++)
        rates[tile] = rates[tile] > LEAST_RATE * most ? rates[tile] / most : LEAST_RATE;
    return true;
}

static double work_of(const struct tile_plan *plan, uint32_t tile, int octave, unsigned rounds)
{
    return plan->looks[tile].work * (double)leaves_after(main_rounds(octave, rounds));
}

static double work_at(const struct tile_plan *plan, const double *rates, double scale,
                      unsigned rounds)
{
    double work = 0;
    for (uint32_t tile = 0; tile < plan->tiles; tile++)
        work += work_of(plan, tile, octave_below(scale * rates[tile]), rounds);
    return work;
}

/* Scale the rates so that the work fits in that of equal factors, and give what is left to tiles
 * that are nearest to a larger factor, in their order. */
static void fill_octaves(struct tile_plan *plan, const double *rates, unsigned rounds)
{
    double budget = 0, low = 0, high = 1;
    for (uint32_t tile = 0; tile < plan->tiles; tile++)
        budget += work_of(plan, tile, 0, rounds);
    while (high < 1e9 && work_at(plan, rates, high, rounds) <= budget) {
        low = high;
        high *= 2;
    }
    for (int i = 0; i < 40; i++) {
        double middle = low + (high - low) / 2;
        if (work_at(plan, rates, middle, rounds) <= budget)
            low = middle;
        else
            high = middle;
    }
    double left = budget;
    for (uint32_t tile = 0; tile < plan->tiles; tile++) {
        plan->octaves[tile] = (int8_t)octave_below(low * rates[tile]);
        left -= work_of(plan, tile, plan->octaves[tile], rounds);
    }
    for (uint32_t tile = 0; tile < plan->tiles; tile++) {
        int larger = octave_below(high * rates[tile]);
        double more = work_of(plan, tile, larger, rounds) -
                      work_of(plan, tile, plan->octaves[tile], rounds);
        if (more > left)
            continue;
        plan->octaves[tile] = (int8_t)larger;
        left -= more;
    }
}

/* By the pilot's figures, with what the pilot itself costs and gives. */
static double predicted_gain(const struct tile_plan *plan, unsigned rounds)
{
    double pilot = (double)leaves_after(plan->pilot_rounds), equal = (double)leaves_after(rounds);
    double weight = plan->pilot_weight, rest = 1 - weight;
    double uniform = 0, adaptive = 0, uniform_work = 0, adaptive_work = 0;
    for (uint32_t tile = 0; tile < plan->tiles; tile++) {
        const struct tile_look *look = &plan->looks[tile];
        double leaves = (double)leaves_after(main_rounds(plan->octaves[tile], rounds));
        uniform += look->error * pilot / (pilot + equal);
        adaptive += look->error * (weight * weight + rest * rest * pilot / leaves);
        uniform_work += look->work * (pilot + equal);
        adaptive_work += look->work * (pilot + leaves);
    }
    return adaptive > 0 ? uniform / adaptive * (uniform_work / adaptive_work) : 1;
}

bool tile_plan_make(struct tile_plan *plan, unsigned rounds)
{
    assert(plan->pilot_rounds > 0 && !plan->made);
    unsigned main = rounds > plan->pilot_rounds ? rounds - plan->pilot_rounds
                                                : round_reaching(OPEN_END_LEAVES) + 1;
    double *rates = calloc(plan->tiles, sizeof(*rates));
    if (rates == NULL)
        return false;
    if (fill_rates(plan, rates))
        fill_octaves(plan, rates, main);
    free(rates);
    plan->predicted_gain = predicted_gain(plan, main);
    plan->made = true;
    return true;
}
