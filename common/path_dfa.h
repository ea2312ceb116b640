/*
 * The path automaton: which paths count. Paths are read from the eye: every scattering is D (any
 * but a delta event) or S (a delta event), and the path ends at a light. A state tells what was
 * read so far; `accepts` says that light found now completes a wanted path. State 0 is dead:
 * nothing that follows can be wanted, so the path ends there. The default accepts L(D|S)*E, every
 * path.
 */
#ifndef COMMON_PATH_DFA_H
#define COMMON_PATH_DFA_H

#include <stdint.h>

#define PATH_STATES_MAX 64
enum path_symbol { PATH_D = 0, PATH_S = 1, PATH_SYMBOLS = 2 };

struct path_dfa {
    uint32_t state_count, start;
    int32_t next[PATH_STATES_MAX * PATH_SYMBOLS]; /* next[state * PATH_SYMBOLS + symbol] */
    int32_t accepts[PATH_STATES_MAX];             /* 0 or -1: a lane mask */
};

/* Every path: one live state */
static inline struct path_dfa path_dfa_everything(void)
{
    struct path_dfa dfa = { .state_count = 2, .start = 1 };
    dfa.next[1 * PATH_SYMBOLS + PATH_D] = 1;
    dfa.next[1 * PATH_SYMBOLS + PATH_S] = 1;
    dfa.accepts[1] = -1;
    return dfa;
}

#endif
