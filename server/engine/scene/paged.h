// Blocks of memory whose pages lie in a file without a name: the kernel can take the memory back
// and read the pages again, so that such a block may be larger than what there is of it.
#ifndef RN_ENGINE_SCENE_PAGED_H
#define RN_ENGINE_SCENE_PAGED_H

#include <stddef.h>

#include "common/base/status.h"

// Thread-safety: as of memory. Owner: rn_paged_destroy.
struct rn_paged {
    char *bytes; // NULL: there is none
    size_t size; // bytes
};

// All zero, on the disk of `folder`, where all of it has its place from now on. RN_ERROR_NO_SPACE,
// RN_ERROR_IO, RN_ERROR_NO_MEMORY.
enum rn_status rn_paged_create(const char *folder, size_t size, struct rn_paged *ret_paged,
                               struct rn_error *err) RN_MUST_CHECK;
void rn_paged_destroy(struct rn_paged *paged); // a block of none: nothing

// The process holds none of its pages any more, until it looks at them again; what they hold stays.
// Any thread, whatever others do with them meanwhile.
void rn_paged_let_go(const struct rn_paged *paged);
// The same where pages of blocks, of any, are more than `bytes` of the process's memory; pages of
// the program, which it shares with others, are beside that.
void rn_paged_hold_at_most(const struct rn_paged *paged, size_t bytes);
// One byte of it will be looked at soon: its page is fetched meanwhile.
void rn_paged_expect(const void *byte);

#endif
