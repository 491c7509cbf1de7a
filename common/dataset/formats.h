// The layouts of posed photographs that can be read: one row a format.
//
// A row stands in the reader's own file, beside the code that reads what it names; formats.c lists
// the rows. Whatever asks how a dataset is recognised, reads this table: the reader, the client,
// and the page by way of GET /v1/formats.
#ifndef RN_COMMON_DATASET_FORMATS_H
#define RN_COMMON_DATASET_FORMATS_H

#include <stdbool.h>
#include <stddef.h>

#include "common/base/status.h"

#define RN_FORMAT_NAME_MAX 24
#define RN_FORMATS_MAX 16

struct rn_reader;

// By which a folder is recognised: the file is there and, where `member` is given, is a JSON object
// with that member.
struct rn_sign {
    const char *file;
    const char *member; // or NULL
};

// Thread-safety: constant. The lists end with NULL.
struct rn_format {
    const char *name;                 // "colmap": the word of --format
    const char *title;                // "COLMAP"
    const struct rn_sign *signs;      // one of them is enough
    const char *const *documents;     // what is read beside photographs; * stands for a part of a
                                      // name without slashes
    const char *const *photo_folders; // where photographs lie that no document names by its path
    double sphere;                    // radius about the origin of the layout's scenes; 0: none
    enum rn_status (*read)(struct rn_reader *reader, struct rn_error *err);
};

// In the order of precedence for a folder that holds several layouts: the daemon's own, then what
// was written to train from, then the models that those are made from. NULL ends.
extern const struct rn_format *const rn_formats[];

// NULL when no format bears the name.
const struct rn_format *rn_format_find(const char *name);
// "native, multiscale, ...".
void rn_format_names(char *text, size_t capacity);

// The formats whose signs the folder bears, in order; how many. A file that should be JSON and is
// not bears no sign that asks for a member. RN_ERROR_NOT_FOUND when the folder is not there,
// RN_ERROR_INVALID when it is none.
enum rn_status rn_formats_recognise(const char *folder, const struct rn_format *ret_found[],
                                    size_t *ret_count, struct rn_error *err) RN_MUST_CHECK;
// The folder of a dataset that is nearest below this one, as in an archive of a folder; malloc'd,
// NULL where there is none.
char *rn_formats_find_below(const char *folder);

#endif
