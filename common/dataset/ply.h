// Sparse points in a PLY file (Turk 1994, "The PLY polygon file format").
#ifndef RN_COMMON_DATASET_PLY_H
#define RN_COMMON_DATASET_PLY_H

#include "common/dataset/dataset.h"

// Reads the vertices: x, y and z of any type, red, green and blue where they are there; text or
// little-endian binary. Nothing says which photograph sees them. Vertices that are not finite are
// left out, and so are, evenly, those beyond RN_POINTS_MAX. *points must be empty and stays so on
// failure. RN_ERROR_INVALID names the line of the header, or the vertex, that is at fault;
// RN_ERROR_UNSUPPORTED for what is a PLY file and is not read; RN_ERROR_IO, RN_ERROR_NO_MEMORY.
enum rn_status rn_ply_read(const char *path, struct rn_points *points,
                           struct rn_error *err) RN_MUST_CHECK;

#endif
