// The folder of a runner on a node.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/image/lpips.h"
#include "server/slurm/inside.h"

#define MAX_SCRIPT (64u << 10)

char *rn_place_path(const struct rn_slurm *slurm, const struct rn_place *place, const char *name) {
    char *path = NULL;
    int size = asprintf(&path, "%s/%s%s%s", slurm->folder, place->name, *name ? "/" : "", name);
    return size < 0 ? NULL : path;
}

static enum rn_status no_memory(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory for a runner");
}

// 'as the shell reads it'
static void quote(struct rn_buf *script, const char *text) {
    rn_buf_append(script, "'", 1);
    for (; *text != '\0'; text++)
        if (*text == '\'')
            rn_buf_printf(script, "'\\''");
        else
            rn_buf_append(script, text, 1);
    rn_buf_append(script, "'", 1);
}

// What the node runs. SIGTERM is Slurm's word that the end is near.
static const char script_begin[] = "umask 077\n"
                                   "told=\n"
                                   "trap 'told=1; kill -$word $child 2>/dev/null' TERM\n"
                                   "await() {\n"
                                   "    wait $child\n"
                                   "    status=$?\n"
                                   "    while kill -0 $child 2>/dev/null; do # a signal ended it\n"
                                   "        wait $child\n"
                                   "        status=$?\n"
                                   "    done\n"
                                   "}\n";

// Several ranks are one step of Slurm's, which Open MPI's library finds its way in. srun passes
// SIGUSR1 on, and ends at SIGTERM. Runners that are confined copy nothing out of each other's
// memory.
static const char script_ranks[] =
    "ranks=--ranks\n"
    "word=USR1\n"
    "launch=\"srun --mpi=pmix --export=ALL --kill-on-bad-exit=1 "
    "${SLURM_CPUS_PER_TASK:+--cpus-per-task=$SLURM_CPUS_PER_TASK}\"\n"
    "export OMPI_MCA_btl_vader_single_copy_mechanism=none\n";
// Without PMIx's library srun starts nothing, and says so.
static const char script_try[] = "said=$($launch true 2>&1) || case $said in\n"
                                 "*pmix*) echo \"$said\"; exit \"$no_ranks\" ;;\n"
                                 "esac\n";

// A runner that lost its daemon has saved and ended; another one takes its place, and waits for a
// secret of the next daemon.
static const char script_shared[] =
    "[ -d \"$folder\" ] || sleep 5 # a network file system may be behind\n"
    "[ -d \"$folder\" ] || exit \"$not_shared\"\n"
    "[ -x \"$runner\" ] || exit \"$no_program\"\n"
    "[ -n \"$log\" ] && exec >>\"$log\" 2>&1\n";
static const char script_shared_end[] =
    "status=$lost\n"
    "while [ $status = $lost ] && [ -z \"$told\" ] && [ -d \"$folder\" ]; do\n"
    "    $launch \"$runner\" --mode remote $ranks --join \"$folder\" $sandbox </dev/null &\n"
    "    child=$!\n"
    "    await\n"
    "done\n"
    "exit $status\n";

// Without a shared folder the secret comes with the script, on the runner's standard input.
static const char script_carried[] =
    "[ -x \"$runner\" ] || exit \"$no_program\"\n"
    "cache=$cache/ripnerf-$(id -u)/${SLURMD_NODENAME:-node}\n"
    "mkdir -p \"$cache\" || exit \"$no_cache\"\n"
    "\"$runner\" --mode carry --join \"$name\" --cache \"$cache\" --cache-bytes $cache_bytes "
    "$sandbox <<'END' &\n";
static const char script_carried_end[] = "END\n"
                                         "child=$!\n"
                                         "await\n"
                                         "exit $status\n";

static void put_text(struct rn_buf *script, const char *name, const char *text) {
    rn_buf_printf(script, "%s=", name);
    quote(script, text != NULL ? text : "");
    rn_buf_printf(script, "\n");
}

static void put_script(struct rn_slurm *slurm, const struct rn_place *place, const char *folder,
                       struct rn_buf *script) {
    const char *lpips = getenv(RN_LPIPS_VARIABLE);
    rn_buf_printf(script, "#!/bin/sh\n");
    put_text(script, "runner", slurm->runner);
    rn_buf_printf(script, "word=TERM\n%s", place->ranks > 1 ? script_ranks : "ranks=\nlaunch=\n");
    rn_buf_printf(script,
                  "sandbox=%s\nlost=%d\nnot_shared=%d\nno_program=%d\nno_cache=%d\nno_ranks=%d\n",
                  slurm->sandbox ? "--sandbox" : "", RN_JOIN_EXIT_LOST, RN_JOIN_EXIT_NOT_SHARED,
                  RN_JOIN_EXIT_NO_PROGRAM, RN_JOIN_EXIT_NO_CACHE, RN_JOIN_EXIT_NO_RANKS);
    if (lpips != NULL) put_text(script, "export " RN_LPIPS_VARIABLE, lpips);
    if (slurm->cache == NULL) {
        put_text(script, "folder", folder);
        put_text(script, "log", place->log);
        rn_buf_printf(script, "%s%s%s%s", script_begin, script_shared,
                      place->ranks > 1 ? script_try : "", script_shared_end);
        return;
    }
    put_text(script, "name", place->name);
    put_text(script, "cache", slurm->cache);
    rn_buf_printf(script, "cache_bytes=%" PRId64 "\n%s%s", slurm->cache_bytes, script_begin,
                  script_carried);
    rn_join_print(&place->join, script);
    rn_buf_printf(script, "%s", script_carried_end);
}

static enum rn_status write_script(struct rn_slurm *slurm, const struct rn_place *place,
                                   struct rn_error *err) {
    struct rn_buf script;
    char *folder = rn_place_path(slurm, place, ""), *path = rn_place_path(slurm, place, "script");
    rn_buf_init(&script, MAX_SCRIPT);
    put_script(slurm, place, folder != NULL ? folder : "", &script);
    enum rn_status status = rn_buf_status(&script, "script", err);
    if (status == RN_OK && (folder == NULL || path == NULL)) status = no_memory(err);
    if (status == RN_OK) status = rn_file_write_atomic(path, script.data, script.size, err);
    if (script.data != NULL) explicit_bzero(script.data, script.size);
    rn_buf_finish(&script);
    free(folder);
    free(path);
    return status;
}

static enum rn_status link_scene(struct rn_slurm *slurm, const struct rn_place *place,
                                 const char *scene_folder, struct rn_error *err) {
    char *path = rn_place_path(slurm, place, "scene");
    enum rn_status status = path == NULL ? no_memory(err) : RN_OK;
    if (status == RN_OK && symlink(scene_folder, path) != 0)
        status = rn_error_from_errno(err, errno, path, "link the scene's folder");
    free(path);
    return status;
}

static enum rn_status make_secret(struct rn_slurm *slurm, struct rn_place *place,
                                  struct rn_error *err) {
    snprintf(place->join.host, sizeof place->join.host, "%s", slurm->host);
    place->join.port = slurm->port;
    return rn_join_make(&place->join, err);
}

enum rn_status rn_place_invite(struct rn_slurm *slurm, struct rn_place *place,
                               struct rn_error *err) {
    char *folder = rn_place_path(slurm, place, "");
    enum rn_status status = folder == NULL ? no_memory(err) : make_secret(slurm, place, err);
    if (status == RN_OK) status = rn_join_leave(folder, &place->join, err);
    free(folder);
    return status;
}

enum rn_status rn_place_furnish(struct rn_slurm *slurm, struct rn_place *place,
                                const char *scene_folder, struct rn_error *err) {
    char *folder = rn_place_path(slurm, place, "");
    enum rn_status status =
        folder == NULL ? no_memory(err) : rn_mkdirs_in(slurm->data, folder, 0700, err);
    // The runner may be the first to need it, and makes what is below.
    if (status == RN_OK) status = rn_mkdir(scene_folder, 0700, err);
    if (status == RN_OK) status = link_scene(slurm, place, scene_folder, err);
    if (status == RN_OK && slurm->cache != NULL) status = make_secret(slurm, place, err);
    if (status == RN_OK) status = write_script(slurm, place, err);
    if (status == RN_OK && slurm->cache == NULL) status = rn_place_invite(slurm, place, err);
    if (status != RN_OK && folder != NULL && rn_remove_tree(folder, NULL) != RN_OK)
        rn_log(RN_LOG_WARN, "%s stays", folder);
    free(folder);
    return status;
}

enum rn_status rn_place_sign(struct rn_slurm *slurm, const struct rn_place *place,
                             struct rn_error *err) {
    char text[32], *path = rn_place_path(slurm, place, "job");
    int size = snprintf(text, sizeof text, "%" PRId64 "\n", place->job);
    enum rn_status status =
        path == NULL ? no_memory(err) : rn_file_write_atomic(path, text, (size_t)size, err);
    free(path);
    return status;
}

void rn_place_free(struct rn_place *place) {
    if (place->fd >= 0) close(place->fd);
    rn_porter_stop(&place->porter);
    free(place->dataset);
    free(place->train);
    free(place->log);
    explicit_bzero(place, sizeof *place);
    free(place);
}

static void remove_file(const char *path) {
    if (path == NULL || (unlink(path) != 0 && errno != ENOENT))
        rn_log(RN_LOG_ERROR, "%s: %s", path != NULL ? path : "slurm", strerror(errno));
}

// The link goes first: no path of the runner's leads to the scene any more. A runner that is still
// there may hold the lock on a file that has lost its name; the next one makes another.
void rn_place_fence(struct rn_slurm *slurm, const struct rn_place *place) {
    struct rn_error err = {0};
    char *folder = rn_place_path(slurm, place, ""), *link = rn_place_path(slurm, place, "scene");
    char *lock = NULL;
    remove_file(link);
    if (!place->helps && asprintf(&lock, "%s/scenes/%s/lock", slurm->data, place->scene) > 0)
        remove_file(lock);
    if (folder == NULL || rn_remove_tree(folder, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "%s: %s", err.where, err.text);
    free(lock);
    free(link);
    free(folder);
}

// ---- what an earlier daemon left ----------------------------------------------------------------

static bool read_job(struct rn_slurm *slurm, struct rn_place *place) {
    uint8_t *text = NULL;
    size_t size;
    char *path = rn_place_path(slurm, place, "job");
    bool found = path != NULL && rn_file_read(path, 64, &text, &size, NULL) == RN_OK;
    if (found) place->job = strtoll((const char *)text, NULL, 10);
    free(text);
    free(path);
    return found && place->job > 0;
}

static bool read_scene(struct rn_slurm *slurm, struct rn_place *place) {
    char target[PATH_MAX], *path = rn_place_path(slurm, place, "scene");
    ssize_t size = path != NULL ? readlink(path, target, sizeof target - 1) : -1;
    free(path);
    if (size <= 0) return false;
    target[size] = '\0';
    const char *slash = strrchr(target, '/');
    if (slash == NULL || strlen(slash + 1) >= sizeof place->scene) return false;
    snprintf(place->scene, sizeof place->scene, "%s", slash + 1);
    return true;
}

static enum rn_status find(struct rn_slurm *slurm, const char *name, struct rn_error *err) {
    struct rn_place *place = calloc(1, sizeof *place);
    if (place == NULL) return no_memory(err);
    snprintf(place->name, sizeof place->name, "%s", name);
    place->fd = -1;
    place->number = ++slurm->last_number;
    bool known = read_scene(slurm, place), submitted = read_job(slurm, place);
    // One that shares no folder with this machine has no way to another daemon.
    place->given_up = submitted && slurm->cache != NULL;
    place->spare = !place->given_up;
    if (place->given_up) rn_place_fence(slurm, place);
    if (known && submitted) {
        rn_log(RN_LOG_INFO, "Slurm job %" PRId64 " of an earlier daemon, for %s", place->job,
               place->scene);
        place->next = slurm->places;
        slurm->places = place;
        return RN_OK;
    }
    // A job that was submitted at the last moment finds no folder, and ends.
    rn_place_fence(slurm, place);
    rn_place_free(place);
    return RN_OK;
}

enum rn_status rn_place_find_all(struct rn_slurm *slurm, struct rn_error *err) {
    enum rn_status status = rn_mkdirs(slurm->folder, 0700, err);
    if (status != RN_OK) return status;
    DIR *folder = opendir(slurm->folder);
    if (folder == NULL) return rn_error_from_errno(err, errno, slurm->folder, "open the folder");
    struct dirent *entry;
    while (status == RN_OK && (entry = readdir(folder)) != NULL)
        if (entry->d_name[0] != '.' && strlen(entry->d_name) < RN_JOIN_NAME_MAX)
            status = find(slurm, entry->d_name, err);
    closedir(folder);
    return status;
}
