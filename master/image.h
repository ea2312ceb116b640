/*
 * A decoded picture in memory: named float32 channels of one size, top row first. What writers
 * take, readers give and `compare` measures. Owned by one thread at a time.
 */
#ifndef MASTER_IMAGE_H
#define MASTER_IMAGE_H

#include <stdbool.h>
#include <stdint.h>

struct err;

struct image_channel {
    char name[64]; /* "R", "stderr.G", "samples" */
    float *values; /* width * height, row by row, top row first */
    bool exact;    /* float32 in every file: half would not hold it */
};

struct image_attribute {
    char name[64];
    char *text;
};

struct image {
    uint32_t width, height; /* of the data window */
    int32_t data_x, data_y; /* where the data window sits in the display window */
    uint32_t display_width, display_height;
    struct image_channel *channels;
    uint32_t channel_count;
    struct image_attribute *attributes;
    uint32_t attribute_count;
};

/* Zeroed; NULL when memory runs out. image_free(NULL) does nothing. */
struct image *image_new(uint32_t width, uint32_t height);
void image_free(struct image *image);

/* Add a zeroed channel; its values, or NULL when memory runs out. */
float *image_add_channel(struct image *image, const char *name);
float *image_add_exact_channel(struct image *image, const char *name);
/* The values of a channel, or NULL when there is none of that name. */
float *image_channel(const struct image *image, const char *name);

bool image_set_attribute(struct image *image, const char *name, const char *text);
/* The same of what printf makes of it: a number, a few words. */
bool image_note(struct image *image, const char *name, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
const char *image_attribute(const struct image *image, const char *name); /* NULL: none */

#endif
