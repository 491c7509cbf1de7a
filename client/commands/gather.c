#include "client/commands/gather.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/follow.h"
#include "common/base/file.h"
#include "common/path/path.h"
#include "proto/event.h"

// ---- the target ----

static const char *extension_of(const char *out) {
    const char *slash = strrchr(out, '/'), *dot = strrchr(slash ? slash : out, '.');
    return dot ? dot : "";
}

int rn_target_film(const char *out, const char *codec) {
    const char *extension = extension_of(out), *name = NULL;
    if (strcasecmp(extension, ".mp4") == 0) name = codec ? codec : "h264";
    if (strcasecmp(extension, ".webm") == 0) name = "vp9";
    if (strcasecmp(extension, ".gif") == 0) name = "gif";
    return name ? rn_name_index(rn_film_names, name) : -1;
}

static bool is_other_film(const char *out) {
    static const char *const others[] = {".mov", ".avi", ".mkv", ".m4v", ".ogv", NULL};
    for (int i = 0; others[i]; i++)
        if (strcasecmp(extension_of(out), others[i]) == 0) return true;
    return false;
}

static bool holds_frames(const char *folder) {
    struct dirent *entry;
    bool found = false;
    DIR *dir = opendir(folder);
    while (dir && !found && (entry = readdir(dir)))
        found = rn_frame_index(entry->d_name) >= 0;
    if (dir) closedir(dir);
    return found;
}

static bool read_note(struct rn_target *target) {
    uint8_t *text = NULL;
    size_t size = 0;
    if (rn_file_read(target->note, RN_ID_MAX, &text, &size, NULL) != RN_OK) return false;
    snprintf(target->job, sizeof target->job, "%.*s", (int)strcspn((char *)text, "\n"),
             (char *)text);
    free(text);
    return *target->job;
}

// To the folder above, "" where the path names none.
static void go_up(char *path) {
    char *end = path + strlen(path);
    while (end > path && end[-1] == '/')
        end--;
    while (end > path && end[-1] != '/')
        end--;
    while (end > path && end[-1] == '/')
        end--;
    *end = '\0';
}

// How much of a path is there.
static size_t length_there(const char *out) {
    char path[PATH_MAX];
    struct stat about;
    snprintf(path, sizeof path, "%s", out);
    while (*path && stat(path, &about) != 0)
        go_up(path);
    return strlen(path);
}

enum rn_exit rn_target_open(const char *out, bool overwrite, bool resume,
                            struct rn_target *ret_target) {
    struct rn_target target = {
        .out = out, .is_film = rn_target_film(out, NULL) >= 0, .extension = "png"};
    struct rn_error err = {0};
    struct stat about;
    if (snprintf(target.note, sizeof target.note, target.is_film ? "%s.job" : "%s/.ripnerf-job",
                 out) >= (int)sizeof target.note)
        return rn_client_usage("-o", "is too long");
    if (is_other_film(out))
        return rn_client_usage(out, "is no kind of film that is made; use .mp4, .webm or .gif");
    bool there = stat(out, &about) == 0;
    if (there && target.is_film == S_ISDIR(about.st_mode))
        return rn_client_usage(out, target.is_film ? "is a folder" : "is a file, not a folder");
    bool noted = read_note(&target);
    if (!resume || overwrite) {
        if (noted && !overwrite)
            return rn_client_usage(out, "was begun by an earlier call; --resume goes on with it, "
                                        "--overwrite begins anew");
        target.job[0] = '\0';
        if (!overwrite && there && (target.is_film || holds_frames(out)))
            return rn_client_usage(out, target.is_film
                                            ? "is there already; --overwrite replaces it"
                                            : "holds frames already; --overwrite replaces them");
    }
    if (resume && !noted && there && (target.is_film || holds_frames(out)))
        return rn_client_usage(out, "holds nothing that was interrupted; --overwrite replaces it");
    target.made = !there && !target.is_film;
    if (target.made) target.there = length_there(out);
    *ret_target = target;
    if (target.made && rn_mkdirs(out, 0777, &err) != RN_OK) return rn_client_not_written(&err);
    return rn_client_check_target(target.note, true);
}

void rn_target_close(const struct rn_target *target) {
    char path[PATH_MAX];
    if (!target->made) return;
    snprintf(path, sizeof path, "%s", target->out);
    for (; strlen(path) > target->there; go_up(path))
        (void)rmdir(path); // one that holds something stays
}

// ---- bringing ----

// Frames on their way into a folder. A frame that is there is not fetched again.
struct frames {
    struct rn_client client; // with a connection of its own: the events' one is busy
    const struct rn_target *target;
    const char *job;
    bool resumed;
    size_t written;
    unsigned char seen[(RN_PATH_MAX_FRAMES + 7) / 8]; // a bit each
};

// GETs a path of the job's into a file.
static enum rn_exit fetch(struct frames *frames, const char *tail, const char *file) {
    char path[128];
    snprintf(path, sizeof path, "/v1/jobs/%s/%s", frames->job, tail);
    return rn_api_save(&frames->client, path, file);
}

static enum rn_exit fetch_frame(struct frames *frames, int64_t index) {
    char tail[40], file[4096];
    unsigned char bit = (unsigned char)(1u << (index % 8));
    if (index < 0 || index >= RN_PATH_MAX_FRAMES || (frames->seen[index / 8] & bit))
        return RN_EXIT_OK;
    snprintf(tail, sizeof tail, "frames/%lld", (long long)index);
    int size = snprintf(file, sizeof file, "%s/%05lld.%s", frames->target->out, (long long)index,
                        frames->target->extension);
    if (size < 0 || (size_t)size >= sizeof file) return rn_client_usage("-o", "is too long");
    bool kept = frames->resumed && access(file, F_OK) == 0;
    enum rn_exit code = kept ? RN_EXIT_OK : fetch(frames, tail, file);
    if (code != RN_EXIT_OK) return code;
    frames->seen[index / 8] |= bit;
    frames->written++;
    return code;
}

static bool on_frame(struct rn_follow *follow, const struct rn_sse_event *event) {
    struct rn_frame_event frame;
    if (strcmp(event->type, RN_EVENT_FRAME) != 0 ||
        rn_decode(&rn_frame_event_table, event->data, event->size_bytes, &frame, NULL, NULL) !=
            RN_OK)
        return true;
    follow->code = fetch_frame(follow->context, frame.index);
    return follow->code == RN_EXIT_OK;
}

// The frames whose events were missed.
static enum rn_exit fetch_rest(struct frames *frames, int64_t first, int64_t count) {
    enum rn_exit code = RN_EXIT_OK;
    for (int64_t i = 0; i < count && code == RN_EXIT_OK; i++)
        code = fetch_frame(frames, first + i);
    return code;
}

struct path_summary {
    char job[RN_ID_MAX];
    char *folder, *film; // borrowed
    int64_t frames, bytes;
    char setting[96]; // as in rn_path_result, below too
    double expected_psnr, expected_spread;
};
static const struct rn_field_spec path_summary_fields[] = {
    RN_F_TEXT(struct path_summary, job, RN_REQUIRED, NULL),
    RN_F_STRING(struct path_summary, folder, 0, 4096),
    RN_F_STRING(struct path_summary, film, 0, 4096),
    RN_F_INT(struct path_summary, frames, RN_REQUIRED, 0, RN_PATH_MAX_FRAMES),
    RN_F_INT(struct path_summary, bytes, 0, 0, INFINITY),
    RN_F_TEXT(struct path_summary, setting, 0, NULL),
    RN_F_NUMBER(struct path_summary, expected_psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(struct path_summary, expected_spread, 0, 0, INFINITY)};
static const struct rn_table path_summary_table =
    RN_TABLE(struct path_summary, "summary", path_summary_fields);

// What a budget became, after all else.
static void print_setting(const struct rn_path_result *result) {
    if (*result->setting) printf("; by what was asked for: %s", result->setting);
    if (!isnan(result->expected_psnr)) printf(", %.1f dB expected", result->expected_psnr);
    if (!isnan(result->expected_spread)) printf(" +- %.1f", result->expected_spread);
    putchar('\n');
}

static void print_summary(bool json, const struct frames *frames,
                          const struct rn_path_result *result) {
    char *out = (char *)frames->target->out, bytes[24];
    bool is_film = frames->target->is_film;
    struct path_summary summary = {.folder = is_film ? NULL : out,
                                   .film = is_film ? out : NULL,
                                   .frames = result->frames,
                                   .expected_psnr = result->expected_psnr,
                                   .expected_spread = result->expected_spread,
                                   .bytes = is_film ? result->film_bytes : RN_ABSENT};
    snprintf(summary.job, sizeof summary.job, "%s", frames->job);
    memcpy(summary.setting, result->setting, sizeof summary.setting);
    char *text = json ? rn_api_encode(&path_summary_table, &summary) : NULL;
    rn_format_bytes((double)result->film_bytes, bytes, sizeof bytes);
    if (text)
        puts(text);
    else if (!json && is_film)
        printf("%s: %lld frame%s of %lldx%lld, %s", out, (long long)result->frames,
               result->frames == 1 ? "" : "s", (long long)result->width, (long long)result->height,
               bytes);
    else if (!json)
        printf("%zu frame%s in %s", frames->written, frames->written == 1 ? "" : "s", out);
    if (!json) print_setting(result);
    free(text);
}

static enum rn_exit bring(struct frames *frames, const struct rn_follow *follow, int64_t first,
                          bool json) {
    struct rn_path_result result;
    struct rn_error err = {0};
    const char *text = follow->job.result;
    if (!text || rn_decode(&rn_path_result_table, text, strlen(text), &result, NULL, &err) != RN_OK)
        return rn_client_fail(&err);
    enum rn_exit code = frames->target->is_film ? fetch(frames, "film", frames->target->out)
                                                : fetch_rest(frames, first, result.frames);
    if (code == RN_EXIT_OK) print_summary(json, frames, &result);
    return code;
}

static enum rn_exit follow_and_bring(struct rn_client *client, struct frames *frames,
                                     int64_t first) {
    struct rn_error err = {0};
    char also[600];
    struct rn_follow follow = {.client = client,
                               .quiet = client->json,
                               .also = also,
                               .event = frames->target->is_film ? NULL : on_frame,
                               .context = frames};
    enum rn_exit code = RN_EXIT_OK;
    snprintf(
        also, sizeof also,
        "Its frames will be at %s/v1/jobs/%s/frames.tar; the same command with --resume brings "
        "them",
        rn_http_host(client->http), frames->job);
    if (rn_http_create_twin(client->http, &frames->client.http, &err) != RN_OK)
        code = rn_client_fail(&err);
    if (code == RN_EXIT_OK) code = rn_follow_job(&follow, frames->job);
    if (code == RN_EXIT_OK) code = bring(frames, &follow, first, client->json);
    bool cut_off = code == RN_EXIT_FAILED || code == RN_EXIT_CANCELLED;
    if (cut_off && !follow.detached)
        rn_client_note("ripnerf: the same command with --resume goes on with what is there");
    if (!cut_off && code != RN_EXIT_UNREACHABLE)
        unlink(frames->target->note); // it is done, or would end the same way
    rn_follow_finish(&follow);
    rn_http_destroy(&frames->client.http);
    return code;
}

// Of a job that this call submitted, and whose pictures have no place.
static void cancel(struct rn_client *client, const char *job) {
    struct rn_api_reply reply;
    char *path = rn_api_path("jobs", job, "/cancel");
    if (!path) return;
    rn_api_send(client, "POST", path, NULL, &reply);
    free(path);
    if (reply.code == RN_EXIT_OK) rn_client_note("ripnerf: job %s is cancelled", job);
    rn_api_reply_finish(&reply);
}

enum rn_exit rn_gather(struct rn_client *client, const struct rn_target *target, const char *job,
                       int64_t first) {
    struct rn_error err = {0};
    char id[RN_ID_MAX + 1];
    struct frames *frames = calloc(1, sizeof *frames);
    if (!frames) return RN_EXIT_FAILED;
    frames->client = *client;
    frames->target = target;
    frames->job = job;
    frames->resumed = *target->job;
    int size = snprintf(id, sizeof id, "%s\n", job);
    enum rn_exit code = RN_EXIT_OK;
    if (rn_file_write_atomic(target->note, id, (size_t)size, &err) != RN_OK)
        code = rn_client_not_written(&err);
    if (code == RN_EXIT_OK)
        code = follow_and_bring(client, frames, first);
    else if (!frames->resumed)
        cancel(client, job);
    free(frames);
    return code;
}
