#include "master/pbrt_state.h"

#include "master/pbrt_args.h"
#include "master/pbrt_reader.h"

#define COUNT(a)   (sizeof(a) / sizeof((a)[0]))
#define STACK_MOST 4096 /* AttributeBegins inside each other */

struct pbrt_frame {
    struct pbrt_state state;
    struct source_pos pos;
    unsigned import_depth; /* of the lexer in an imported file; 0: another block */
};

void pbrt_state_start(struct pbrt_reader *reader)
{
    reader->state.ctm = reader->state.ctm_end = transform_identity();
    reader->state.emitter = SCENE_NONE;
    for (int i = 0; i < TARGETS; i++)
        reader->stack.defaults[i].reader = reader;
}

bool pbrt_state_moves(const struct pbrt_state *state)
{
    for (int i = 0; i < 16; i++)
        if (state->ctm.m[i / 4][i % 4] != state->ctm_end.m[i / 4][i % 4])
            return true;
    return false;
}

void pbrt_state_free(struct pbrt_stack *stack)
{
    growing_free(&stack->frames);
    for (int i = 0; i < TARGETS; i++)
        pbrt_params_free(&stack->defaults[i]);
}

/* --- The stack ---------------------------------------------------------------------------- */

bool pbrt_state_attribute_begin(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    if (reader->stack.frames.count == STACK_MOST)
        return pbrt_report_error(reader, &directive->pos,
                                 "more than %d AttributeBegins inside each other", STACK_MOST);
    struct pbrt_frame *frame = growing_add(&reader->stack.frames, 1, sizeof(*frame));
    if (frame == NULL)
        return pbrt_report_no_memory(reader);
    for (int i = 0; i < TARGETS; i++) {
        reader->state.defaults[i].items = reader->stack.defaults[i].items.count;
        reader->state.defaults[i].numbers = reader->stack.defaults[i].numbers.count;
        reader->state.defaults[i].strings = reader->stack.defaults[i].strings.count;
    }
    *frame = (struct pbrt_frame){ .state = reader->state, .pos = directive->pos };
    return true;
}

static void restore(struct pbrt_reader *reader)
{
    const struct pbrt_frame *frame = (struct pbrt_frame *)reader->stack.frames.data +
                                     --reader->stack.frames.count;
    reader->state = frame->state;
    for (int i = 0; i < TARGETS; i++) {
        reader->stack.defaults[i].items.count = reader->state.defaults[i].items;
        reader->stack.defaults[i].numbers.count = reader->state.defaults[i].numbers;
        reader->stack.defaults[i].strings.count = reader->state.defaults[i].strings;
    }
}

static struct pbrt_frame *innermost(struct pbrt_reader *reader)
{
    size_t count = reader->stack.frames.count;
    return count > 0 ? (struct pbrt_frame *)reader->stack.frames.data + count - 1 : NULL;
}

bool pbrt_state_attribute_end(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    const struct pbrt_frame *top = innermost(reader);
    if (top == NULL || top->import_depth > 0)
        return pbrt_report_error(reader, &directive->pos, "AttributeEnd without an AttributeBegin");
    if (!pbrt_objects_may_close(reader, directive))
        return false;
    restore(reader);
    return true;
}

bool pbrt_state_import(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    if (!pbrt_state_attribute_begin(reader, name))
        return false;
    innermost(reader)->import_depth = pbrt_lexer_depth(reader->lexer);
    reader->stack.imports++;
    return true;
}

bool pbrt_state_end_imports(struct pbrt_reader *reader)
{
    while (reader->stack.imports > 0) {
        const struct pbrt_frame *first = reader->stack.frames.data, *top = innermost(reader);
        const struct pbrt_frame *import = top;
        while (import->import_depth == 0 && import > first)
            import--;
        if (import->import_depth <= pbrt_lexer_depth(reader->lexer))
            return true;
        if (import != top)
            return pbrt_report_error(reader, &top->pos,
                                     "this block is not closed at the end of the imported file");
        reader->stack.imports--;
        restore(reader);
    }
    return true;
}

bool pbrt_state_closed(struct pbrt_reader *reader)
{
    if (reader->stack.frames.count == 0)
        return true;
    const struct pbrt_frame *frames = reader->stack.frames.data;
    return pbrt_report_error(reader, &frames[reader->stack.frames.count - 1].pos,
                             "this block is not closed at the end of the file");
}

/* --- Directives that set a member --------------------------------------------------------- */

bool pbrt_state_attribute(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    static const struct pbrt_name targets[] = {
        { "shape", TARGET_SHAPE, NAME_OURS, NULL },
        { "light", TARGET_LIGHT, NAME_OURS, NULL },
        { "material", TARGET_MATERIAL, NAME_OURS, NULL },
        { "medium", TARGET_MEDIUM, NAME_OURS, NULL },
        { "texture", TARGET_TEXTURE, NAME_OURS, NULL },
    };
    struct pbrt_token target;
    const struct pbrt_name *found;
    return pbrt_args_string(reader, directive, &target) &&
           pbrt_names_choose(reader, "target of Attribute", targets, COUNT(targets), &target,
                             &found) &&
           pbrt_params_read(&reader->params, "Attribute", &target, NULL) &&
           pbrt_params_append(&reader->stack.defaults[found->value], &reader->params);
}

bool pbrt_state_reverse_orientation(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    (void)directive;
    reader->state.reverse_orientation = !reader->state.reverse_orientation;
    return true;
}

bool pbrt_state_color_space(struct pbrt_reader *reader, const struct pbrt_token *directive)
{
    static const struct pbrt_name spaces[] = {
        { "srgb", COLOR_SRGB, NAME_OURS, NULL },
        { "aces2065-1", COLOR_ACES2065_1, NAME_OURS, NULL },
        { "dci-p3", COLOR_DCI_P3, NAME_OURS, NULL },
        { "rec2020", COLOR_REC2020, NAME_OURS, NULL },
    };
    struct pbrt_token name;
    const struct pbrt_name *found;
    if (!pbrt_args_string(reader, directive, &name) ||
        !pbrt_names_choose(reader, "color space", spaces, COUNT(spaces), &name, &found))
        return false;
    reader->state.color_space = (enum color_space)found->value;
    if (found->value != COLOR_SRGB && !reader->in_world)
        pbrt_report_note(reader, &name.pos, "the picture is written in linear sRGB, not in %s",
                         found->text);
    return true;
}
