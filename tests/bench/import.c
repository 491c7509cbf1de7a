// Imports a dataset folder without a daemon:
//
//   import SOURCE TARGET [max_size=0] [scales=1] [every=0] [format=NAME] [alpha=premultiplied]
//
// each `every`-th view tests; `alpha=straight` averages scales as the published benchmark does.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/dataset/dataset.h"

static bool take(const char *argument, struct rn_import_options *options,
                 struct rn_read_options *how) {
    const char *value = strchr(argument, '=');
    size_t size = value ? (size_t)(value - argument) : 0;
    if (!value++) return false;
    if (size == 8 && memcmp(argument, "max_size", size) == 0)
        options->max_size = atoi(value);
    else if (size == 6 && memcmp(argument, "scales", size) == 0)
        options->scales = atoi(value);
    else if (size == 5 && memcmp(argument, "every", size) == 0)
        options->test_every = atoi(value);
    else if (size == 6 && memcmp(argument, "format", size) == 0)
        how->format = value;
    else if (size == 5 && memcmp(argument, "alpha", size) == 0)
        options->downscale =
            strcmp(value, "straight") == 0 ? RN_DOWNSCALE_STRAIGHT : RN_DOWNSCALE_PREMULTIPLIED;
    else
        return false;
    return true;
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct rn_dataset *dataset = NULL;
    struct rn_import_options options = {.scales = 1, .threads = 2};
    struct rn_read_options how = {0};
    bool good = argc >= 3;
    for (int i = 3; i < argc; i++)
        good = good && take(argv[i], &options, &how);
    if (!good) {
        fprintf(stderr, "usage: import SOURCE TARGET [max_size=PX] [scales=K] [every=N] "
                        "[format=NAME] [alpha=straight]\n");
        return 2;
    }
    if (rn_dataset_read_as(argv[1], &how, NULL, &dataset, &err) != RN_OK ||
        rn_mkdirs(argv[2], 0755, &err) != RN_OK ||
        rn_dataset_import(dataset, "bench", &options, argv[2], NULL, NULL, NULL, &err) != RN_OK) {
        fprintf(stderr, "import: %s: %s\n", err.where, err.text);
        return 1;
    }
    rn_dataset_destroy(&dataset);
    return 0;
}
