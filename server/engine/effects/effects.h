// What a scene calls for: each effect is one file that measures the data, says so in the record
// with its number, threshold and reason, and switches the configuration; RN_EFFECTS
// (common/settings/effects.h) lists them.
//
// Where an effect acts is one of these hooks. What is off costs nothing: those inside the sample
// loop are constant parameters of the kernels.
//
//   hook                             reference               CPU             CUDA
//   the photographs                  rn_effect_row.treat     -               -
//                                    and take
//   the march and rays of a step     rn_effect_row.march     -               -
//   the space that is sampled        field/space.h           cpu/space.h     cuda/space.cuh
//   the ray of a pixel               kernels/ray.h           cpu/rays.h      kernels/ray.h
//   where a sample lies, how large   field/frustum.h         cpu/encode.h    cuda/encode.cuh
//   the colour of a ray              field/colour.h, with rn_effect_row.colour
//   the loss of a pixel              field/loss.h
//   the cones of a picture's pixel   render/cones.h          -               -
//   the photographs' cameras         scene/pose.h            train/poses.c   -
//   the colour network's inputs      field/mlp.h             cpu/packet.h    - (0 in pictures)
//   the pixels that rays are of      train/outliers.h        train/sampler.c -
#ifndef RN_ENGINE_EFFECTS_EFFECTS_H
#define RN_ENGINE_EFFECTS_EFFECTS_H

#include "server/engine/effects/about.h"
#include "server/engine/scene/pixels.h"
#include "server/engine/scene/scene.h"

// What effects look at.
struct rn_evidence {
    struct rn_engine *engine;
    struct rn_field *field; // whose configuration they switch, and which keeps the records
    const struct rn_pixels *photographs; // that are trained on, with their views
    int64_t step;                        // that comes next
    double done;                         // share of the schedule that is over; NAN without a limit
    struct rn_march_options march;       // of that step; before training none
    bool pose_gain_known;                // what cameras gain by being sought is measured
    double pose_gain;                    // dB; NAN: nothing is held out
    bool outlier_share_known;            // what photographs show and the others do not is measured
    double outlier_share;                // of the training pixels
};

// In which the record's number and threshold are told.
struct rn_effect_unit {
    const char *name; // behind the number: " dB"
    double factor;    // that the number is told times; 0: as 2 to the power of it,
    const char *one;  // and what it is called where that is 1
};
// On which side of its threshold a number calls for an effect; neither: no number decides.
enum rn_effect_side { RN_EFFECT_OVER, RN_EFFECT_AT_MOST, RN_EFFECT_EITHER };

// One effect. A hook that it does not have is NULL.
struct rn_effect_row {
    struct rn_effect_unit unit;
    enum rn_effect_side side;
    // What it brings can be measured: beside a training without it, and where it is off beside one
    // with it.
    bool optional, optional_when_off;
    bool cpu_alone; // a GPU does not train with it
    unsigned fit;   // RN_FIT_*: what withheld photographs differ in where it is on
    // Before there is a field: what kind of one is trained, and in which ball. Fills the record.
    void (*prepare)(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *record);
    // Before anything is allocated: fills the record, whose name is there and which counts as
    // decided.
    void (*detect)(const struct rn_evidence *evidence, struct rn_effect_record *record);
    // Switches the configuration as the records say.
    void (*settle)(const struct rn_evidence *evidence);
    // Of one that is undecided: whether training has come far enough, and its decision.
    bool (*is_due)(const struct rn_evidence *evidence);
    void (*decide)(const struct rn_evidence *evidence, struct rn_effect_record *record);
    // What it makes of the colour of rays, in training and in pictures.
    void (*colour)(const struct rn_field *field, struct rn_colouring *colouring);
    // What it makes of the step at which `done` of the schedule is over.
    void (*march)(const struct rn_train_config *config, double done,
                  struct rn_march_options *march);
    // How photographs are loaded, those to train on or those that are `held` out.
    void (*treat)(const struct rn_train_config *config, const struct rn_effect_record *record,
                  bool held, struct rn_pixel_treatment *treatment);
    // Of one that is on: what it makes of those to train on.
    void (*take)(struct rn_pixels *photographs, struct rn_engine *engine);
    // Training rays are other ones from this step on.
    void (*turn)(const struct rn_evidence *evidence);
};
#define RN_EFFECT_ROW(CONSTANT, ROW, NAME) extern const struct rn_effect_row rn_effect_##ROW;
RN_EFFECTS(RN_EFFECT_ROW)
#undef RN_EFFECT_ROW

// Whether an effect is on that the data calls for or not, and that can be or not, where the
// configuration may say otherwise.
static inline bool rn_effect_choose(const struct rn_train_config *config, enum rn_effect effect,
                                    bool can, bool called_for) {
    enum rn_effect_choice choice = config->effect[effect];
    return can && (choice == RN_EFFECT_WANTED || (choice == RN_EFFECT_AUTO && called_for));
}

// What is decided before there is a field, which a GPU will train where `on_gpu`: the ball to train
// in, the configuration's space, and the records of the effects that say so; the others are empty.
struct rn_bounds rn_effects_prepare(const struct rn_dataset *dataset, bool on_gpu,
                                    struct rn_train_config *config,
                                    struct rn_effect_record ret_records[RN_EFFECT_COUNT]);
// Measures all other effects, then switches the configuration, the last effect first: later ones
// rest on the earlier.
void rn_effects_detect(const struct rn_evidence *evidence);
bool rn_effects_are_due(const struct rn_evidence *evidence);
void rn_effects_decide(const struct rn_evidence *evidence); // those that are due
// A field's march as trained, whatever the step, and that of pictures where nothing else is asked
// for, which differs in its step (rn_picture_step).
struct rn_march_options rn_effects_march_trained(const struct rn_field *field);
struct rn_march_options rn_effects_march_pictures(const struct rn_field *field);
void rn_effects_march(const struct rn_train_config *config, double done,
                      struct rn_march_options *march);
void rn_effects_treat(const struct rn_train_config *config,
                      const struct rn_effect_record records[RN_EFFECT_COUNT], bool held,
                      struct rn_pixel_treatment *treatment);
void rn_effects_take(struct rn_field *field, struct rn_pixels *photographs,
                     struct rn_engine *engine);
void rn_effects_turn(const struct rn_evidence *evidence);

// Times that a training makes its photographs smaller.
int rn_effect_scale(const struct rn_dataset *dataset, const struct rn_train_config *config);

// How far cameras were moved on the mean, degrees and bounds' radii, into pose-refinement's record.
void rn_effect_tell_moves(struct rn_effect_record *record, double turn_deg, double shift);

// ---- what several effects measure ----

// Whether the photographs are a renderer's: layouts that say what their scene's ball is are.
static inline bool rn_evidence_is_rendered(const struct rn_evidence *evidence) {
    return evidence->field->bounds.source == RN_BOUNDS_LAYOUT;
}

#define RN_EVIDENCE_PROBES 512 // rays looked at
// Beyond it, in levels, cameras see a scene at several scales: footprints 1.4 times as large.
#define RN_SCALE_RANGE 0.5

// A training pixel, and four random numbers of which the last is not used for it.
struct rn_probe {
    const struct rn_pixel_frame *frame;
    int x, y;
    uint32_t random[4];
};
// Probe `i` of a stream of them.
struct rn_probe rn_evidence_probe(const struct rn_evidence *evidence, uint64_t stream, int i);
// Its ray, marched in `step` (scene radii); no target.
struct rn_march_ray rn_evidence_ray(const struct rn_evidence *evidence,
                                    const struct rn_probe *probe, double step);
// The smallest and the largest radius of a training pixel's cone at the scene's centre, dataset
// units; the largest is 0 where no cone has a width.
void rn_evidence_cones(const struct rn_evidence *evidence, double *ret_smallest,
                       double *ret_largest);

#endif
