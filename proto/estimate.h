// What a training will take, before it starts: the options and result of an `estimate` job.
#ifndef RN_PROTO_ESTIMATE_H
#define RN_PROTO_ESTIMATE_H

#include "proto/codec.h"

#define RN_CALIBRATION_LOOKS 3
#define RN_CALIBRATION_LOOKED 0.46875 // of its schedule, at the last look; they are as far apart

// What a runner measured: the beginning of the training, looked at three times.
struct rn_calibration {
    // On the training clock, and held out, at the looks; NAN: nothing is.
    double seconds[RN_CALIBRATION_LOOKS], psnr[RN_CALIBRATION_LOOKS];
    double whole_seconds; // of the training that was begun; NAN: made by an older build
    double step_seconds;  // on the mean, until the last look
    double turn_seconds;  // until then, between steps: passes over the photographs; NAN
    double load_seconds;  // all before the first step, once
    double spent_seconds; // in all
    double max_seconds;   // that the training asked for may take; 0: no limit
    int64_t max_steps;    // 0: no limit
    int64_t memory_bytes; // of the runner, at the end
    int64_t disk_bytes;   // of the checkpoints and marks that will be kept
    char device[16], kernels[32];
    int64_t threads;
};
extern const struct rn_table rn_calibration_table;

// When a training passes a PSNR.
struct rn_estimate_passing {
    double psnr;    // dB
    double seconds; // of training, as was expected; NAN: not within its limits
    double reached; // as it was; NAN: not, or not yet
};

// How wrong the estimates of trainings were that have ended since.
struct rn_estimate_past {
    int64_t estimates;  // of this machine's
    double psnr_off;    // mean of the differences' sizes, dB; NAN: none is known
    double seconds_off; // the same of the passings' times, as a share; NAN
};

struct rn_estimate {
    double seconds;                       // of training until its end; NAN: no limit is known
    double psnr;                          // held out, at the end; NAN: nothing is held out
    double psnr_spread;                   // two of three are within
    struct rn_estimate_passing *passings; // owned
    size_t passing_count;
    double load_seconds;
    int64_t memory_bytes, disk_bytes;
    struct rn_estimate_past past;
    struct rn_calibration calibration;
};
extern const struct rn_table rn_estimate_table;

// What a training with `standard` takes, told before there is any calibration: by its preset and a
// formula.
struct rn_expected {
    double seconds, memory_bytes; // NAN: not known
};
extern const struct rn_table rn_expected_table;

// The same by those that have ended here, of any dataset.
struct rn_expected_past {
    int64_t trainings;            // absent: none
    double seconds, memory_bytes; // from start to end, loading and all; NAN: not known
};
extern const struct rn_table rn_expected_past_table;

// What a training's result keeps of the estimate that was made for it: with the truth beside.
struct rn_estimate_check {
    char job[RN_ID_MAX]; // the estimate's
    double seconds, psnr;
    struct rn_estimate_passing *passings; // owned
    size_t passing_count;
};
extern const struct rn_table rn_estimate_check_table;

#define RN_ESTIMATE_PASSINGS 8

#endif
