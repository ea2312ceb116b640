#include "master/image.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct image *image_new(uint32_t width, uint32_t height)
{
    struct image *image = calloc(1, sizeof(*image));
    if (image == NULL)
        return NULL;
    image->width = image->display_width = width;
    image->height = image->display_height = height;
    return image;
}

void image_free(struct image *image)
{
    if (image == NULL)
        return;
    for (uint32_t i = 0; i < image->channel_count; i++)
        free(image->channels[i].values);
    for (uint32_t i = 0; i < image->attribute_count; i++)
        free(image->attributes[i].text);
    free(image->channels);
    free(image->attributes);
    free(image);
}

float *image_add_channel(struct image *image, const char *name)
{
    struct image_channel *channels = reallocarray(image->channels, image->channel_count + 1,
                                                  sizeof(*channels));
    if (channels == NULL)
        return NULL;
    image->channels = channels;

    struct image_channel *channel = &channels[image->channel_count];
    channel->exact = false;
    snprintf(channel->name, sizeof(channel->name), "%s", name);
    size_t pixels = (size_t)image->width * image->height;
    channel->values = calloc(pixels > 0 ? pixels : 1, sizeof(float));
    if (channel->values == NULL)
        return NULL;
    image->channel_count++;
    return channel->values;
}

float *image_add_exact_channel(struct image *image, const char *name)
{
    float *values = image_add_channel(image, name);
    if (values != NULL)
        image->channels[image->channel_count - 1].exact = true;
    return values;
}

float *image_channel(const struct image *image, const char *name)
{
    for (uint32_t i = 0; i < image->channel_count; i++) {
        if (strcmp(image->channels[i].name, name) == 0)
            return image->channels[i].values;
    }
    return NULL;
}

static struct image_attribute *find_attribute(const struct image *image, const char *name)
{
    for (uint32_t i = 0; i < image->attribute_count; i++) {
        if (strcmp(image->attributes[i].name, name) == 0)
            return &image->attributes[i];
    }
    return NULL;
}

bool image_set_attribute(struct image *image, const char *name, const char *text)
{
    char *copy = strdup(text);
    if (copy == NULL)
        return false;

    struct image_attribute *attribute = find_attribute(image, name);
    if (attribute != NULL) {
        free(attribute->text);
        attribute->text = copy;
        return true;
    }

    struct image_attribute *attributes = reallocarray(image->attributes, image->attribute_count + 1,
                                                      sizeof(*attributes));
    if (attributes == NULL) {
        free(copy);
        return false;
    }
    image->attributes = attributes;
    attribute = &attributes[image->attribute_count++];
    snprintf(attribute->name, sizeof(attribute->name), "%s", name);
    attribute->text = copy;
    return true;
}

bool image_note(struct image *image, const char *name, const char *format, ...)
{
    char text[128];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    return image_set_attribute(image, name, text);
}

const char *image_attribute(const struct image *image, const char *name)
{
    const struct image_attribute *attribute = find_attribute(image, name);
    return attribute != NULL ? attribute->text : NULL;
}
