// Inside proto/: checks of texts for the tables. NULL, or what is wrong.
#ifndef RN_PROTO_CHECKS_H
#define RN_PROTO_CHECKS_H

#include <stdbool.h>
#include <stdint.h>

const char *rn_check_name(const char *text);      // the name of a dataset, scene, path
const char *rn_check_reference(const char *text); // an id or a name
const char *rn_check_split_spec(const char *text);
const char *rn_check_bounds(const char *text);     // "X,Y,Z,RADIUS"
const char *rn_check_up(const char *text);         // "X,Y,Z" or an axis, "-y"
const char *rn_check_crop(const char *text);       // "X0,Y0,Z0,X1,Y1,Z1"
const char *rn_check_inner_path(const char *text); // of a file or folder within another
const char *rn_check_format(const char *text);     // of rn_formats
const char *rn_check_device(const char *text);
const char *rn_check_kernels(const char *text);
const char *rn_check_view(const char *text); // "test:12"
const char *rn_check_sha256(const char *text);

#endif
