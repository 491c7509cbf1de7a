#!/bin/bash
# Breaks server/jobs and server/store in ways that programmers do, in a scratch copy of the tree, and
# runs the simulation, which must find each: mutations.sh [SECONDS [PATTERN]], SECONDS for each after the
# kept seeds, PATTERN choosing some by name. Closes with `N of N caught`. mutations.sh --applies runs nothing and says in a
# second whether each edit still changes its file.
set -u
cd "$(dirname "$0")/../.." || exit 1
tree=$PWD
. tests/support/mutations.sh
[[ ${1-} == --applies ]] && applies_only && shift
seconds=${1:-300}
pattern=${2:-}

if ! $dry; then
    scratch=$(mktemp -d) || exit 1
    trap 'rm -rf "$scratch"' EXIT
    source=$scratch/source pristine=$tree build=$scratch/build
    mkdir "$source"
    git ls-files --cached --others --exclude-standard -z | xargs -0 cp --parents -t "$source"
    meson setup "$build" "$source" --buildtype=release -Dcuda=disabled >"$scratch/log" 2>&1 ||
        { cat "$scratch/log"; exit 1; }
fi

# 0 passed, 1 failed, 2 did not build.
simulate() {
    ninja -j2 -C "$build" tests/sim/sim >"$scratch/log" 2>&1 || return 2
    "$build/tests/sim/sim" --seeds tests/sim/seeds.txt >"$scratch/log" 2>&1 || return 1
    "$build/tests/sim/sim" --seconds "$seconds" >"$scratch/log" 2>&1 || return 1
}

# mutate FILE WHAT SED_SCRIPT
mutate() {
    edit "$1" "$2" "$3" simulate && ! $dry && echo "           $(head -1 "$scratch/log")"
}

jobs=server/jobs
store=server/store
mutate $store/store.c "the log of the database is not flushed" 's/synchronous = FULL/synchronous = OFF/'
mutate $store/store.c "copies of records are not written" '/^        rn_records_write_changed(store);/s/.*/        store->changed_count = 0;/'
mutate $store/sweep.c "uploads go once their import has begun" 's/WHERE id = ?1 AND finished_ms = 0", id/WHERE id = ?1 AND started_ms = 0", id/'
mutate $store/schema.c "it is not remembered which scenes were deleted" 's/"CREATE TRIGGER scenes_removed AFTER DELETE ON scenes"/"CREATE TRIGGER scenes_removed AFTER INSERT ON keys"/'
mutate $jobs/task.c "a job that starts is not written down" 's/    status = persist(control, task, err);/    status = event == RN_JOB_START ? RN_OK : persist(control, task, err);/'
mutate $jobs/task.c "pictures are taken back after their job has succeeded" \
    '/if (rn_job_is_over(next)) rn_frames_take_back(control, task);/d;s/^    rn_task_announce(control, task);/    if (rn_job_is_over(next)) rn_frames_take_back(control, task);&/'
mutate $jobs/task.c "what could not be written is never written" 's/    enum rn_status status = persist(control, task, err);/    enum rn_status status = RN_OK;/'
mutate $jobs/task.c "a lost job stays with its runner" '/^                  const struct rn_ending \*ending) {/{n;d}'
mutate $jobs/machine.c "a lost job is queued without being interrupted" 's/? RN_JOB_INTERRUPTED : -1/? RN_JOB_QUEUED : -1/'
mutate $jobs/control.c "interrupted jobs are forgotten by the next daemon" 's/RN_JOB_CANCELLING, RN_JOB_INTERRUPTED};/RN_JOB_CANCELLING, RN_JOB_CANCELLING};/'
mutate $jobs/late.c "a runner that hangs is waited for" 's/> control->options.runner_timeout_s \* 1000000000ll/> INT64_MAX - 1/'
mutate $jobs/schedule.c "one training more than there are slots" 's/count_active(control, RN_JOB_TRAIN, RN_JOB_ESTIMATE) </count_active(control, RN_JOB_TRAIN, RN_JOB_ESTIMATE) <=/'
mutate $jobs/submit.c "a key is written after its job" 's/status = rn_store_insert(control->store, &rn_keys, &key, err);/status = RN_OK;/'
mutate $jobs/submit.c "a scene's files go before its record" 's/^    enum rn_status status = rn_task_settle_scene(/    if (task == NULL) remove_folder(control, "scenes", scene->id);\n&/'
mutate $jobs/submit.c "a deleted scene's runner goes on" 's/if (runner != NULL) rn_runner_remove(control, runner, true);/(void)runner;/'
mutate $jobs/render.c "who has left is not let go" 's/if (found) rn_parked_answer(parked, NULL);/(void)found;/'

# What the simulation has found, as it was.
mutate $jobs/message.c "a dataset is written apart from the end of its import" \
    's/    task->makes = &dataset;/    if (rn_store_insert(control->store, \&rn_datasets, \&dataset, err) != RN_OK) return RN_ERROR_IO;/'
mutate $jobs/message.c "a scene that came as a file is written apart from the end of its import" \
    's/    task->makes_scene = &scene;/    if (rn_store_insert(control->store, \&rn_scenes, \&scene, err) != RN_OK) return RN_ERROR_IO;/'
mutate $jobs/submit.c "the name of an upload is not flushed" \
    's/status = rn_file_rename(wanted->spooled, draft->job.source, err);/status = rename(wanted->spooled, draft->job.source) == 0 ? RN_OK : RN_ERROR_IO;/'
mutate $jobs/frames.c "the place of a film's frames is not flushed" \
    's/status = rn_file_rename(places.lent, places.kept, &err);/status = rename(places.lent, places.kept) == 0 ? RN_OK : RN_ERROR_NOT_FOUND;/'
mutate $jobs/runner.c "a training that is resumed does not wait for its slot" \
    's/ || task->row.state == RN_JOB_QUEUED) \/\/ for a slot/)/'
mutate $jobs/submit.c "a scene is deleted before the end of its training is written" \
    's/= rn_task_settle_scene(control, scene->id, err)/= RN_OK/'
mutate $store/sweep.c "what was removed is forgotten before it is" '/^    if (sweep.status == RN_OK) sweep.status = flush(store, err);/d'
mutate $store/records.c "a copy whose seal was lost is taken for a good one" 's/return same && rn_seal_check(path, sha256, NULL) == RN_OK;/return same;/'
mutate $store/records.c "a folder that was made for nothing is content" 's/looking->found |= !is_bare(path);/looking->found = true;/'

conclude
