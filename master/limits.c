#include "master/limits.h"

#include "master/ledger.h"

/* A round may end so much late, or the last ones before would leave too much of the time unused;
 * and predictions of what is left are off by so much. */
#define LATE_SHARE  0.04
#define LATE_MOST_S 1.0
#define LEFT_MARGIN 1.05

bool limits_are_open(const struct limits *limits)
{
    return limits->relmse > 0 || limits->time_s > 0 || limits->core_s > 0;
}

bool limits_met(const struct limits *limits, const struct ledger_row *row)
{
    return limits->relmse > 0 && row->accuracy.verdict == ACCURACY_KNOWN &&
           row->accuracy.relmse <= limits->relmse;
}

static bool fits_in_time(double limit_s, const struct outlook *outlook)
{
    double late = LATE_SHARE * limit_s;
    late = late < LATE_MOST_S ? late : LATE_MOST_S;
    return outlook->elapsed_s + LEFT_MARGIN * outlook->left_s <= limit_s + late;
}

enum limit limits_against(const struct limits *limits, const struct outlook *outlook)
{
    if (outlook->rounds > limits->rounds)
        return LIMIT_SPP;
    if (limits->time_s > 0 && !fits_in_time(limits->time_s, outlook))
        return LIMIT_TIME;
    if (limits->core_s > 0 && !(outlook->spent_core_s + outlook->left_core_s <= limits->core_s))
        return LIMIT_BUDGET;
    return LIMIT_NONE;
}

const char *limits_text(enum limit limit)
{
    switch (limit) {
#define X(name, text)  \
    case LIMIT_##name: \
        return text;
        LIMIT_MAP(X)
#undef X
    }
    return "";
}
