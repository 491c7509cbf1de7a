// import, of a scene: a file that export --as scene wrote.
#ifndef RN_CLIENT_COMMANDS_SCENE_FILE_H
#define RN_CLIENT_COMMANDS_SCENE_FILE_H

#include <stdbool.h>
#include <stdint.h>

#include "client/api.h"

// By its name, .ripscene, or by how it begins.
bool rn_is_scene_file(const char *path);
// Checks the file here; complains. *ret_bytes: how large it is.
enum rn_exit rn_check_scene_file(const char *path, uint64_t *ret_bytes);
// Sends it, waits until it is a scene and prints that. dataset: whose photographs it may be
// compared with, NULL: none.
enum rn_exit rn_import_scene(struct rn_client *client, const char *path, const char *name,
                             const char *dataset);

#endif
