#include "common/dataset/json_memory.h"

#include <pthread.h>
#include <stdalign.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

#include "common/base/log.h"

#define RESERVE (1u << 20)

static alignas(16) char reserve[RESERVE];
static size_t used, blocks; // of the reserve; it is whole again when its last block is given back
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static void *take_reserve(size_t size) {
    void *taken = NULL;
    pthread_mutex_lock(&lock);
    if (size <= RESERVE - used) {
        taken = reserve + used;
        used += (size + 15) & ~(size_t)15;
        blocks++;
    }
    pthread_mutex_unlock(&lock);
    return taken;
}

static __thread bool loading;

static void *allocate(size_t size) {
    void *block = malloc(size);
    if (block == NULL && loading) block = take_reserve(size);
    if (block != NULL || !loading) return block;
    rn_log(RN_LOG_ERROR, "out of memory while JSON was read, and of its reserve: ending");
    abort();
}

static void give_back(void *block) {
    const uintptr_t at = (uintptr_t)block, begin = (uintptr_t)reserve;
    if (at < begin || at >= begin + RESERVE) {
        free(block);
        return;
    }
    pthread_mutex_lock(&lock);
    if (--blocks == 0) used = 0;
    pthread_mutex_unlock(&lock);
}

__attribute__((constructor)) static void set_allocator(void) {
    json_set_alloc_funcs(allocate, give_back);
}

json_t *rn_json_load(const char *json, size_t size, json_error_t *error) {
    loading = true;
    json_t *root = json_loadb(json, size, JSON_REJECT_DUPLICATES, error);
    loading = false;
    return root;
}
