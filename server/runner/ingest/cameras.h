// Which photographs one camera took, as COLMAP is told.
#ifndef RN_SERVER_RUNNER_INGEST_CAMERAS_H
#define RN_SERVER_RUNNER_INGEST_CAMERAS_H

#include "common/dataset/photos.h"

#define RN_CAMERAS_SETTLED 10 // photographs of one camera that settle four distortion parameters

// Gives photographs of one camera one camera in COLMAP's database, which has a SIMPLE_RADIAL one
// for each photograph: of the kind OPENCV for RN_CAMERAS_SETTLED or more. RN_ERROR_CORRUPT for a
// database that is not as COLMAP's, RN_ERROR_NO_MEMORY.
enum rn_status rn_cameras_share(const struct rn_photos *photos, const char *database,
                                struct rn_error *err) RN_MUST_CHECK;

#endif
