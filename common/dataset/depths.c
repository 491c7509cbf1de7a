// Near and far of photographs that look one way, where the source gives neither: by the sparse
// points that they are known to see.
#include <math.h>
#include <stdlib.h>

#include "common/dataset/calls.h"
#include "common/dataset/reader.h"
#include "common/math/numbers.h"

#define LEAST 100    // sightings that say so
#define SURE 5       // photographs that see a point; what few see may be a wrong match
#define NEARER 0.001 // share of the sightings that is nearer than near,
#define WITHIN 0.995 // and that is no farther than far, behind which space goes on

static bool are_called_for(const struct rn_dataset *dataset) {
    for (size_t i = 0; i < dataset->frame_count; i++)
        if (dataset->frames[i].far > 0) return false;
    return dataset->points.sighting_count >= LEAST && rn_looks_one_way(dataset);
}

// Along the photographs' axes, of what lies before them and surely there; their number. `seen`:
// room for a number of each point, 0.
static size_t list_depths(const struct rn_dataset *dataset, const struct rn_frame **frames,
                          size_t photos, uint32_t *seen, double *depths) {
    const struct rn_points *points = &dataset->points;
    size_t count = 0;
    for (size_t i = 0; i < points->sighting_count; i++)
        seen[points->sightings[i].point]++;
    for (size_t i = 0; i < points->sighting_count; i++) {
        const struct rn_sighting *sighting = &points->sightings[i];
        double axes[3];
        if (sighting->photo >= photos || !frames[sighting->photo]) continue;
        if (seen[sighting->point] < SURE) continue;
        rn_camera_axes(&frames[sighting->photo]->camera, points->items[sighting->point].position,
                       axes);
        if (axes[2] > 0) depths[count++] = axes[2];
    }
    return count;
}

enum rn_status rn_dataset_find_depths(struct rn_dataset *dataset, struct rn_error *err) {
    if (!are_called_for(dataset)) return RN_OK;
    size_t photos, count = 0;
    const struct rn_frame **frames = rn_frames_by_photo(dataset, &photos);
    double *depths = malloc(dataset->points.sighting_count * sizeof *depths);
    uint32_t *seen = calloc(dataset->points.count, sizeof *seen);
    bool enough = frames && depths && seen;
    if (enough) count = list_depths(dataset, frames, photos, seen, depths);
    double near = rn_numbers_quantile(depths, count, NEARER);
    double far = rn_numbers_quantile(depths, count, WITHIN);
    for (size_t i = 0; count >= LEAST && far > near && i < dataset->frame_count; i++) {
        dataset->frames[i].near = near;
        dataset->frames[i].far = far;
    }
    free(frames);
    free(depths);
    free(seen);
    return enough ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
}
