// Where a path job's frames or film go, and bringing them there.
#ifndef RN_CLIENT_COMMANDS_GATHER_H
#define RN_CLIENT_COMMANDS_GATHER_H

#include <limits.h>

#include "client/client.h"
#include "proto/names.h"

// A folder for frames, or a film's file.
struct rn_target {
    const char *out; // borrowed
    bool is_film;
    bool made;             // the folder, by rn_target_open,
    size_t there;          // and all above it beyond so many bytes of `out`
    const char *extension; // of frames, static
    char note[PATH_MAX];   // a file that holds the job's id while it is under way
    char job[RN_ID_MAX];   // to go on with; "" for a new one
};

// The codec (rn_film_names) that a file's name asks for; -1: it is no film. `codec`: of an .mp4.
int rn_target_film(const char *out, const char *codec);
// Looks at what is there and refuses to replace it unasked; complains. `resume` takes up the job of
// an earlier call.
enum rn_exit rn_target_open(const char *out, bool overwrite, bool resume,
                            struct rn_target *ret_target);
// Takes away folders that rn_target_open made and nothing came into.
void rn_target_close(const struct rn_target *target);
// Follows the job and brings its frames as they come, from number `first` on, or its film; prints a
// summary. The note goes once all is there.
enum rn_exit rn_gather(struct rn_client *client, const struct rn_target *target, const char *job,
                       int64_t first);

#endif
