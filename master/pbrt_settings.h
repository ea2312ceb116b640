/*
 * How the picture is computed: Sampler, Integrator, Accelerator, Option. Part of the pbrt reader.
 * What decides only how fast or how noisy pbrt is, is accepted and not used, nor is what would make
 * the picture another than its light transport's (a note says so); what asks for another picture
 * altogether is refused. False: the reader's err is set.
 */
#ifndef MASTER_PBRT_SETTINGS_H
#define MASTER_PBRT_SETTINGS_H

#include "master/pbrt_lexer.h"

#include <stdbool.h>

struct pbrt_reader;

/* The parameters were read; `type` is the quoted name. */
bool pbrt_settings_sampler(struct pbrt_reader *reader, const struct pbrt_token *type);
bool pbrt_settings_integrator(struct pbrt_reader *reader, const struct pbrt_token *type);

/* These read what follows their word. */
bool pbrt_settings_accelerator(struct pbrt_reader *reader, const struct pbrt_token *directive);
bool pbrt_settings_option(struct pbrt_reader *reader, const struct pbrt_token *directive);

#endif
