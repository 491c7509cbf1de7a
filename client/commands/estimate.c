#include "client/commands/estimate.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "client/follow.h"
#include "client/progress.h"
#include "client/table.h"
#include "common/settings/train.h"
#include "proto/job.h"

static void print_takes(double seconds, double bytes) {
    char time[24], memory[24];
    rn_format_seconds(seconds, time, sizeof time);
    rn_format_bytes(bytes, memory, sizeof memory);
    if (!isnan(seconds)) printf(" %s", time);
    if (!isnan(bytes)) printf("%s %s of memory", isnan(seconds) ? "" : " and", memory);
}

void rn_print_expected(const struct rn_expected *expected) {
    printf("training    standard:");
    print_takes(expected->seconds, expected->memory_bytes);
    printf(" by formula; draft %g s, or as long as you like (--max-time)\n",
           rn_settings_find(&rn_train_settings, "max_seconds")->draft);
}

// As they are given to import; "-" where the files stay as they are.
static void write_options(const struct rn_import_choice *choice, char *text, size_t capacity) {
    size_t used = 0;
    text[0] = '\0';
    if (choice->max_size != RN_ABSENT)
        used += (size_t)snprintf(text, capacity, " --max-size %lld", (long long)choice->max_size);
    if (*choice->split)
        used += (size_t)snprintf(text + used, capacity - used, " --split %s", choice->split);
    if (choice->scales != RN_ABSENT)
        used += (size_t)snprintf(text + used, capacity - used, " --scales %lld",
                                 (long long)choice->scales);
    if (!used) snprintf(text, capacity, " -");
}

void rn_print_choices(const struct rn_import_choice *choices, size_t count) {
    struct rn_text_table table;
    struct rn_error err;
    if (!count) return;
    rn_text_table_init(&table,
                       "options|>train|>test|>pixels|>trained at|>memory|>loading, training");
    for (size_t i = 0; i < count; i++) {
        const struct rn_import_choice *c = &choices[i];
        char options[80], memory[24], load[24], train[24];
        write_options(c, options, sizeof options);
        rn_format_bytes(c->memory_bytes, memory, sizeof memory);
        rn_format_seconds(c->load_seconds, load, sizeof load);
        rn_format_seconds(c->seconds, train, sizeof train);
        rn_text_table_row(&table, "%s|%lld|%lld|%lldx%lld|1/%lld|%s|%s, %s", options + 1,
                          (long long)c->views.train, (long long)c->views.test, (long long)c->width,
                          (long long)c->height, (long long)c->train_scale, memory, load, train);
    }
    putchar('\n');
    if (rn_text_table_print(&table, &err) != RN_OK) rn_client_fail(&err);
    putchar('\n');
    rn_text_table_finish(&table);
}

void rn_print_past(const struct rn_expected_past *past) {
    if (past->trainings == RN_ABSENT || (isnan(past->seconds) && isnan(past->memory_bytes))) return;
    printf("training with standard takes");
    print_takes(past->seconds, past->memory_bytes);
    printf(", by %lld training%s here\n", (long long)past->trainings,
           past->trainings == 1 ? "" : "s");
}

static void print_end(const struct rn_estimate *estimate) {
    char seconds[24], load[24];
    rn_format_seconds(estimate->seconds, seconds, sizeof seconds);
    rn_format_seconds(estimate->load_seconds, load, sizeof load);
    printf("ends after %s of training", seconds);
    if (isnan(estimate->psnr))
        printf(", with a PSNR that cannot be told beforehand");
    else
        printf(", with %.1f dB +- %.1f held out", estimate->psnr, estimate->psnr_spread);
    printf("; loading takes %s\n", load);
}

static void print_passings(const struct rn_estimate *estimate) {
    for (size_t i = 0; i < estimate->passing_count && !isnan(estimate->psnr); i++) {
        const struct rn_estimate_passing *passing = &estimate->passings[i];
        char seconds[24];
        rn_format_seconds(passing->seconds, seconds, sizeof seconds);
        if (isnan(passing->seconds))
            printf("%g dB is not reached\n", passing->psnr);
        else
            printf("%g dB after %s\n", passing->psnr, seconds);
    }
}

static void print_past(const struct rn_estimate_past *past) {
    if (past->estimates == 0) {
        puts("no training here has ended yet that was estimated before");
        return;
    }
    printf("%lld estimate%s of trainings here %s off by %.1f dB", (long long)past->estimates,
           past->estimates == 1 ? "" : "s", past->estimates == 1 ? "was" : "were", past->psnr_off);
    if (!isnan(past->seconds_off)) printf(" and %.0f %% of the time", 100 * past->seconds_off);
    putchar('\n');
}

static enum rn_exit print_estimate(const char *json) {
    struct rn_estimate estimate;
    struct rn_error err = {0};
    char memory[24], disk[24], spent[24];
    if (rn_decode(&rn_estimate_table, json, strlen(json), &estimate, NULL, &err) != RN_OK)
        return rn_client_fail(&err);
    print_passings(&estimate);
    print_end(&estimate);
    rn_format_bytes((double)estimate.memory_bytes, memory, sizeof memory);
    rn_format_bytes((double)estimate.disk_bytes, disk, sizeof disk);
    rn_format_seconds(estimate.calibration.spent_seconds, spent, sizeof spent);
    printf("%s of memory, %s on disk; measured in %s on %s, %s, %lld thread%s\n", memory, disk,
           spent, estimate.calibration.device, estimate.calibration.kernels,
           (long long)estimate.calibration.threads, estimate.calibration.threads == 1 ? "" : "s");
    print_past(&estimate.past);
    rn_message_finish(&rn_estimate_table, &estimate);
    return RN_EXIT_OK;
}

enum rn_exit rn_wait_for_estimate(struct rn_client *client, const char *job) {
    struct rn_follow follow = {.client = client, .quiet = client->json};
    enum rn_exit code = rn_follow_job(&follow, job);
    if (code == RN_EXIT_OK && follow.job.result) {
        if (client->json)
            puts(follow.job.result);
        else
            code = print_estimate(follow.job.result);
    }
    rn_follow_finish(&follow);
    return code;
}
