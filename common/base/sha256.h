// SHA-256 (FIPS 180-4).
#ifndef RN_COMMON_BASE_SHA256_H
#define RN_COMMON_BASE_SHA256_H

#include <stddef.h>
#include <stdint.h>

// Thread-safety: one thread at a time. A plain value: no resources, may be copied.
struct rn_sha256 {
    uint32_t state[8];
    uint64_t size_bytes; // hashed so far
    uint8_t block[64];   // size_bytes % 64 bytes wait here
};

void rn_sha256_init(struct rn_sha256 *hash);
void rn_sha256_update(struct rn_sha256 *hash, const void *bytes, size_t size_bytes);
// Writes 64 lower-case hex digits and a NUL. The hash needs rn_sha256_init to be used again.
void rn_sha256_final_hex(struct rn_sha256 *hash, char ret_hex[65]);

#endif
