// import: what of a folder is sent, and nothing else of it.
#ifndef RN_CLIENT_COMMANDS_PACK_H
#define RN_CLIENT_COMMANDS_PACK_H

#include "common/base/tar.h"
#include "common/dataset/dataset.h"
#include "common/dataset/photos.h"

// Documents, images and masks that were read, named below the folder.
enum rn_status rn_pack_dataset(struct rn_tar *tar, const char *folder,
                               const struct rn_dataset *dataset,
                               struct rn_error *err) RN_MUST_CHECK;
// Photographs and their masks; a film alone.
enum rn_status rn_pack_photos(struct rn_tar *tar, const char *folder,
                              const struct rn_photos *photos, struct rn_error *err) RN_MUST_CHECK;

#endif
