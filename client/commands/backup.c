// backup, restore: a data folder, or what belongs to one scene, as one file, and back.

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/api.h"
#include "client/interrupt.h"
#include "common/base/file.h"
#include "common/base/tar.h"
#include "proto/adopted.h"

#define IDLE_S 600 // seconds without a byte before a backup is given up

struct backup_options {
    const char *scene;
};
static const struct rn_option backup_table[] = {
    {.name = "scene",
     .kind = RN_OPTION_TEXT,
     .offset = offsetof(struct backup_options, scene),
     .value = "SCENE",
     .help = "only this scene, with its checkpoints, its dataset and the jobs of\nboth"},
    {0}};

static const struct rn_option no_options[] = {{0}};

// ---- backup ---------------------------------------------------------------------------------

static enum rn_exit download(struct rn_client *client, const char *scene, const char *file,
                             int fd) {
    struct rn_error err = {0};
    struct rn_buf path;
    rn_buf_init(&path, SIZE_MAX);
    rn_buf_printf(&path, "/v1/backup%s", scene != NULL ? "?scene=" : "");
    if (scene != NULL) rn_http_escape(&path, scene);
    enum rn_exit code = rn_buf_status(&path, "--scene", &err) == RN_OK
                            ? rn_api_download(client, (const char *)path.data, IDLE_S, fd, file)
                            : rn_client_fail(&err);
    rn_buf_finish(&path);
    if (code != RN_EXIT_OK || fsync(fd) == 0) return code;
    rn_error_from_errno(&err, errno, file, "write");
    return rn_client_fail(&err);
}

// The file has its name only once it is whole.
static enum rn_exit run_backup(struct rn_client *client, const void *options, const char **args) {
    const struct backup_options *opt = options;
    struct rn_error err = {0};
    char partial[4200];
    struct stat about;
    const char *file = args[0];
    if (stat(file, &about) == 0)
        return rn_client_usage(file, "is there already; choose another name");
    if (snprintf(partial, sizeof partial, "%s.partial", file) >= (int)sizeof partial)
        return rn_client_usage(file, "is too long a name");
    if (rn_interrupt_catch(&err) != RN_OK) return rn_client_fail(&err);
    int fd = open(partial, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (fd < 0) {
        rn_error_from_errno(&err, errno, partial, "create");
        return rn_client_not_written(&err);
    }
    enum rn_exit code = download(client, opt->scene, file, fd);
    if (fstat(fd, &about) != 0) about.st_size = 0;
    close(fd);
    if (code == RN_EXIT_OK && rn_file_rename(partial, file, &err) != RN_OK)
        code = rn_client_fail(&err);
    if (code != RN_EXIT_OK) (void)unlink(partial);
    if (code == RN_EXIT_OK && client->json)
        code = rn_client_print_file(file, about.st_size);
    else if (code == RN_EXIT_OK)
        printf("%lld bytes in %s; to use them: ripnerf restore %s DIR\n", (long long)about.st_size,
               file, file);
    return code;
}

// ---- restore --------------------------------------------------------------------------------

struct archive {
    const char *name, *folder; // of the archive; where it goes
    struct rn_tar_contents contents;
};

static bool go_on(void *context) {
    (void)context;
    return !rn_interrupt_seen();
}

static enum rn_status unpack(struct archive *archive, struct rn_error *err) {
    char records[4400];
    enum rn_status status =
        rn_tar_unpack(archive->name, archive->folder, go_on, NULL, &archive->contents, err);
    snprintf(records, sizeof records, "%s/ripnerf.db", archive->folder);
    if (status == RN_OK && access(records, F_OK) != 0)
        status = rn_error_set(err, RN_ERROR_CORRUPT, archive->name,
                              "it has no records: it is no backup, or not a whole one");
    return status;
}

static enum rn_status restore(struct archive *archive, const char *folder, struct rn_error *err) {
    enum rn_status status = rn_remove_tree(archive->folder, err);
    if (status == RN_OK) status = rn_mkdirs(archive->folder, 0700, err);
    if (status == RN_OK) status = unpack(archive, err);
    if (status == RN_OK) status = rn_file_rename(archive->folder, folder, err);
    if (status != RN_OK && rn_remove_tree(archive->folder, NULL) != RN_OK)
        rn_client_note("ripnerf: %s is left over; remove it", archive->folder);
    return status;
}

// Whether a folder may be renamed to this: nothing is there, or an empty folder.
static bool is_free(const char *name) {
    DIR *folder = opendir(name);
    int entries = 0; // with . and ..
    if (!folder) return errno == ENOENT;
    while (readdir(folder))
        entries++;
    closedir(folder);
    return entries <= 2;
}

static enum rn_exit restore_folder(const struct rn_client *client, const char *file,
                                   const char *name) {
    struct rn_error err = {0};
    char folder[4096], partial[4200];
    struct archive archive = {.name = file, .folder = partial};
    size_t length = strlen(name);
    while (length > 1 && name[length - 1] == '/')
        length--;
    if (length >= sizeof folder) return rn_client_usage(name, "is too long a name");
    snprintf(folder, sizeof folder, "%.*s", (int)length, name);
    snprintf(partial, sizeof partial, "%s.partial", folder);
    if (!is_free(folder))
        return rn_client_usage(folder, "is there already; a backup goes into a new folder, or, "
                                       "without one, to what a daemon has");
    if (rn_interrupt_catch(&err) != RN_OK) return rn_client_fail(&err);
    if (restore(&archive, folder, &err) != RN_OK) return rn_client_fail(&err);
    if (client->json) return rn_client_print_file(folder, archive.contents.bytes);
    printf("%lld files, %lld bytes; now: ripnerfd --data %s --scrub, and start it\n",
           (long long)archive.contents.files, (long long)archive.contents.bytes, folder);
    return RN_EXIT_OK;
}

// ---- into a daemon that runs ------------------------------------------------------------------

static size_t read_part(void *context, char *buffer, size_t capacity) {
    FILE *file = context;
    size_t got = fread(buffer, 1, capacity, file);
    return ferror(file) ? SIZE_MAX : got;
}

static enum rn_exit print_adopted(const struct rn_client *client,
                                  const struct rn_api_reply *reply) {
    struct rn_adopted_record adopted;
    if (client->json) {
        puts((const char *)reply->http.body.data);
        return RN_EXIT_OK;
    }
    enum rn_exit code = rn_api_decode(reply, &rn_adopted_table, &adopted);
    if (code == RN_EXIT_OK)
        printf("joined: %lld scenes, %lld datasets, %lld camera paths, %lld jobs; what was there "
               "stays as it is\n",
               (long long)adopted.scenes, (long long)adopted.datasets,
               (long long)adopted.camera_paths, (long long)adopted.jobs);
    return code;
}

static enum rn_exit restore_into_daemon(struct rn_client *client, const char *name) {
    struct rn_error err = {0};
    struct rn_api_reply reply;
    struct stat about;
    FILE *file = fopen(name, "rbe");
    if (file == NULL) {
        rn_error_from_errno(&err, errno, name, "open");
        return rn_client_fail(&err);
    }
    if (fstat(fileno(file), &about) != 0 || !S_ISREG(about.st_mode)) {
        fclose(file);
        return rn_client_error(RN_EXIT_INVALID, name, "is no file; give what ripnerf backup wrote");
    }
    const struct rn_http_request request = {.method = "POST",
                                            .path = "/v1/backup",
                                            .content_type = "application/x-tar",
                                            .read = read_part,
                                            .body_size = (size_t)about.st_size,
                                            .context = file,
                                            .idle_s = IDLE_S};
    rn_api_exchange(client, &request, &reply);
    fclose(file);
    enum rn_exit code =
        reply.code == RN_EXIT_OK ? print_adopted(client, &reply) : rn_api_complain(&reply);
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit run_restore(struct rn_client *client, const void *options, const char **args) {
    (void)options;
    return args[1] != NULL ? restore_folder(client, args[0], args[1])
                           : restore_into_daemon(client, args[0]);
}

const struct rn_verb rn_verbs_backup[] = {
    {.name = "backup",
     .arguments = "FILE",
     .summary = "all that the daemon keeps, or one scene, as of one moment, as one file",
     .details = "The daemon goes on meanwhile. What is deleted while it is made may be in neither; "
                "a\ntraining is in it with its last checkpoint.",
     .args_min = 1,
     .args_max = 1,
     .table = backup_table,
     .options_size = sizeof(struct backup_options),
     .run = run_backup},
    {.name = "restore",
     .arguments = "FILE [DIR]",
     .summary = "a backup into a new folder DIR, or into a daemon that runs",
     .details =
         "Nothing has the folder's name before all of the backup is there; it is for "
         "ripnerfd --data DIR.\nWithout DIR what the backup holds joins what the daemon has: "
         "all of it or, when something in it\nis damaged, nothing. A name that is taken gets a "
         "suffix.",
     .args_min = 1,
     .args_max = 2,
     .table = no_options,
     .run = run_restore},
    {0}};
