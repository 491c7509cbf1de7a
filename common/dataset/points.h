// The sparse points of a native dataset: points.bin beside dataset.json. Internal to
// common/dataset.
#ifndef RN_COMMON_DATASET_POINTS_H
#define RN_COMMON_DATASET_POINTS_H

#include "common/dataset/dataset.h"

#define RN_POINTS_DOCUMENT "points.bin"

// Little endian: the magic, 2 x u64 counts, then points of 32 bytes (3 x f64, f32, 3 x u8, 0) and
// sightings of 16 (2 x u32, 2 x f32). The file is on disk only after rn_output_sync.
enum rn_status rn_points_write(const struct rn_points *points, const char *path,
                               struct rn_error *err) RN_MUST_CHECK;
// RN_ERROR_INVALID for a file that is cut, or has other numbers than a point's or sighting's.
enum rn_status rn_points_read(const char *path, struct rn_points *ret_points,
                              struct rn_error *err) RN_MUST_CHECK;
// Whether a point may lie there: as a camera (RN_CAMERA_MAX_AWAY).
bool rn_points_take(const double position[3]);
// Only the first so many stay, and no sightings.
void rn_points_cut(struct rn_points *points, size_t count);
void rn_points_finish(struct rn_points *points);

#endif
