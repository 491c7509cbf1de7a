// The curve of a scene: GET /v1/scenes/{id}/curve, the result of a `curve` job, and the file
// curve.json in the scene's folder.
#ifndef RN_PROTO_CURVE_H
#define RN_PROTO_CURVE_H

#include "common/settings/curve.h"
#include "proto/codec.h"

// How points are measured and what is noted of them: another number wherever what a budget takes
// from a curve changes its meaning.
#define RN_CURVE_METHOD 2

struct rn_curve_record {
    char machine[128], device[16], kernels[32];
    int64_t threads;
    char version[32];
    int64_t method;  // RN_CURVE_METHOD; absent: of before methods were counted
    char digest[65]; // of the checkpoint; "" where it was measured while it trained
    int64_t step;    // of the parameters; as digest
    char measured_at[RN_TIME_MAX];
    bool stale;                    // of other parameters, another machine or another version
    char stale_because[128];       // what is another; "" = absent
    int64_t width, height;         // of its pictures
    int64_t views;                 // that each point was measured on
    bool photographs;              // compared with; false: with the full picture only
    double seconds;                // that it took to measure
    struct rn_curve_point *points; // owned
    size_t count;
    struct rn_curve_view *around; // owned; held-out views, more than the points were measured on
    size_t around_count;
};
extern const struct rn_table rn_curve_record_table;

// The curve in a record; it borrows points and views.
struct rn_curve rn_curve_in(const struct rn_curve_record *record);
// What of that which a curve is of is another now: the parameters, the machine, the way of
// measuring; NULL: nothing. Of `now` kernels may be "", where the machine is not known yet.
const char *rn_curve_changed(const struct rn_curve_record *curve,
                             const struct rn_curve_record *now);
// curve.json of a scene's folder. RN_ERROR_NOT_FOUND: it was not measured; RN_ERROR_INVALID.
enum rn_status rn_curve_read(const char *scene_folder, struct rn_curve_record *ret_record,
                             struct rn_error *err) RN_MUST_CHECK;

// POST /v1/scenes/{id}/curve, and the options of a `curve` job.
struct rn_curve_options {
    int64_t views; // held-out views to measure on; absent = 16
};
extern const struct rn_table rn_curve_options_table;

#endif
