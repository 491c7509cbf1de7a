#include "server/engine/train/withheld.h"

#include <stdio.h>
#include <string.h>

#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define HELD_OUT_VIEWS 8
#define WITHHELD_VIEWS 16 // about, where there are more than eight times as many

// ---- which frames ---------------------------------------------------------------------------

// The split whose views tell the progress: test views where there are no validation views, so that
// every other photograph is trained on, and training views only where there are neither.
static enum rn_split held_out_split(const struct rn_dataset *d) {
    if (d->view_count[RN_SPLIT_VAL] > 0) return RN_SPLIT_VAL;
    return d->view_count[RN_SPLIT_TEST] > 0 ? RN_SPLIT_TEST : RN_SPLIT_TRAIN;
}

// Of how many training views one is held out where there are no others: of 8, and of many views so
// that a round over those held out does not grow with them.
static int withheld_apart(const struct rn_dataset *d) {
    int apart = d->view_count[RN_SPLIT_TRAIN] / WITHHELD_VIEWS;
    return apart > 8 ? apart : 8;
}

// Eight evenly spaced views of the split, or one of so many training views.
static bool is_held_out(const struct rn_dataset *d, const struct rn_frame *frame) {
    enum rn_split split = held_out_split(d);
    int views = d->view_count[split], apart = withheld_apart(d);
    if (frame->split != split) return false;
    if (split == RN_SPLIT_TRAIN) return frame->index % apart == apart - 1;
    int held = views < HELD_OUT_VIEWS ? views : HELD_OUT_VIEWS;
    for (int i = 0; i < held; i++)
        if (frame->index == i * views / held) return true;
    return false;
}

// Rays that are drawn from all pixels alike (`paper`) are drawn from all photographs.
static bool gives_back_some_time(const struct rn_train_config *config) {
    return config->give_back > 0 && config->favour_finest;
}

bool rn_selection_wants(void *selection, const struct rn_frame *frame) {
    const struct rn_selection *s = selection;
    const struct rn_train_config *config = s->config;
    bool held = is_held_out(s->dataset, frame);
    if (s->held) return held;
    if (held && !config->train_held_out && !gives_back_some_time(config)) return false;
    return frame->split == RN_SPLIT_TRAIN || (config->train_val && frame->split == RN_SPLIT_VAL);
}

// ---- what is told ---------------------------------------------------------------------------

// What becomes of photographs that would be trained on, did they not tell the progress.
static void describe_fate(const struct rn_trainer *t, char *ret_text, size_t capacity) {
    const char *so_far = rn_trainer_withholds_any(t) ? " so far" : "";
    if (t->field->config.train_held_out)
        snprintf(ret_text, capacity, "trained on too");
    else if (t->progress.given_back > 0)
        snprintf(ret_text, capacity,
                 RN_WITHHELD " until step %lld and trained on since (the figure is of before)",
                 (long long)t->progress.given_back);
    else
        snprintf(ret_text, capacity, RN_WITHHELD "%s", so_far);
}

static void describe(struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    enum rn_split split = held_out_split(t->dataset);
    bool learned = split == RN_SPLIT_VAL && config->train_val;
    int views = t->dataset->view_count[split];
    int held = t->held.frame_count / (t->held.scale_count > 0 ? t->held.scale_count : 1);
    char fate[112], *text = t->held_out;
    describe_fate(t, fate, sizeof fate);
    if (split == RN_SPLIT_TRAIN)
        snprintf(text, sizeof t->held_out,
                 "%d training views (one of %d) %s: the dataset has no other split", held,
                 withheld_apart(t->dataset), fate);
    else
        snprintf(text, sizeof t->held_out, "%d evenly spaced views of %d %s views%s%s", held, views,
                 split == RN_SPLIT_VAL ? "validation" : "test", learned ? ", " : "",
                 learned ? fate : "");
    size_t length = strlen(text);
    if (config->train_scale > 1)
        snprintf(text + length, sizeof t->held_out - length, ", at 1/%d of their size",
                 config->train_scale);
}

const char *rn_trainer_held_out(const struct rn_trainer *t) {
    return t->held_out;
}

// ---- giving back ----------------------------------------------------------------------------

void rn_trainer_note_withheld(struct rn_trainer *t) {
    t->withheld = 0;
    for (int f = 0; f < t->train.frame_count && !t->field->config.train_held_out; f++)
        t->withheld += is_held_out(t->dataset, t->train.frames[f].frame);
    describe(t);
}

bool rn_trainer_withholds_any(const struct rn_trainer *t) {
    return t->withheld > 0 && t->progress.given_back == 0;
}

bool rn_trainer_withholds(const struct rn_trainer *t, const struct rn_frame *frame) {
    return rn_trainer_withholds_any(t) && is_held_out(t->dataset, frame);
}

bool rn_trainer_gives_back(const struct rn_trainer *t) {
    return rn_trainer_withholds_any(t) && rn_schedule_gives_back(&t->field->config, &t->progress);
}

enum rn_status rn_trainer_give_back(struct rn_trainer *t, struct rn_error *err) {
    t->progress.given_back = t->progress.step;
    describe(t);
    return rn_trainer_list_live(t, err);
}

enum rn_figure rn_trainer_figure(const struct rn_trainer *t) {
    bool learned = t->withheld > 0 && t->progress.given_back > 0;
    if (t->held.frame_count == 0 || learned) return RN_FIGURE_NONE;
    return t->figure_offered ? RN_FIGURE_LAST : RN_FIGURE_ANY_TIME;
}
