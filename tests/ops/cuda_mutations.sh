#!/bin/bash
# Plants bugs in the CUDA kernels and in what the engine does with a device, one at a time in a
# scratch copy, and runs the emulated test that must fail: cuda_mutations.sh [--from N] [PATTERN],
# from the N-th edit on, PATTERN choosing some by name. RIPNERF_BUILD names a build folder whose
# libraries are used. Closes with `N of N caught`; the exit code is 0 only when all were.
# cuda_mutations.sh --applies runs nothing and says in a second whether each edit still changes its file.
set -u
cd "$(dirname "$0")/../.." || exit 1
tree=$PWD
. tests/support/mutations.sh
[[ ${1-} == --applies ]] && applies_only && shift
from=1
[[ ${1-} == --from ]] && from=$2 && shift 2
$dry || build=${RIPNERF_BUILD:?set RIPNERF_BUILD to a build folder}
pattern=${1:-}
scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT
number=0 # of the edit
source=$scratch/tree pristine=$tree

give_up() {
    echo "cuda_mutations.sh: $1" >&2
    exit 1
}

# compile OBJECT SOURCE: the emulated backend out of the scratch copy.
compile() {
    "${CXX:-c++}" -std=c++17 -O1 -D_GNU_SOURCE -ffp-contract=off -fPIC -w -I"$source" \
        -I"$source/tests/ops/cuda_emulator" -c "$source/tests/ops/cuda_emulator/$2" \
        -o "$scratch/$1" >"$scratch/log" 2>&1
}

# libraries PROGRAM: what the build links it with, of the system.
libraries() {
    ninja -C "$build" -t commands "$1" | tail -1 | tr ' ' '\n' | grep -E '^(/.*\.(so|a)|-l.*|-pthread)$'
}

# run CASE: builds the test and runs one of its cases; 0 passed, 1 failed, 2 did not build.
run() {
    compile backend.o backend.cpp || return 2
    # shellcheck disable=SC2046 # words on purpose
    "${CXX:-c++}" -o "$scratch/test" "$build"/tests/ops/cuda_test.p/*.o "$scratch/backend.o" \
        "$scratch/emulator.o" "$build"/server/engine/lib{engine,dispatch}.a \
        "$build"/server/engine/libkernels_*.a "$build/server/engine/libfield.a" \
        "$build/common/libcommon.a" \
        $(libraries tests/ops/cuda_test) \
        >"$scratch/log" 2>&1 || return 2
    CK_RUN_CASE=$1 "$scratch/test" >"$scratch/log" 2>&1 || return 1
}

# run_engine CASE FILE: the same of the engine's test, FILE in place of the engine's own.
run_engine() {
    "${CC:-cc}" -std=c17 -O1 -D_GNU_SOURCE -ffp-contract=off -w -I"$source" \
        -DRN_MODULE_FOLDER='"/nowhere"' -c "$source/$2" -o "$scratch/engine.o" \
        >"$scratch/log" 2>&1 || return 2
    # shellcheck disable=SC2046 # words on purpose
    "${CC:-cc}" -o "$scratch/test" "$build"/tests/ops/device_test.p/*.o "$scratch/engine.o" \
        "$build"/server/engine/lib{engine,dispatch}.a "$build"/server/engine/libkernels_*.a \
        "$build/server/engine/libfield.a" "$build/common/libcommon.a" \
        $(libraries tests/ops/device_test) \
        >"$scratch/log" 2>&1 || return 2
    CK_RUN_CASE=$1 RIPNERF_CUDA_MODULE=$build/tests/ops/ripnerf-cuda-emulated.so \
        "$scratch/test" >"$scratch/log" 2>&1 || return 1
}

# run_trained CASE: the engine's test over the kernels, as a module.
run_trained() {
    compile backend.o backend.cpp || return 2
    "${CXX:-c++}" -shared -o "$scratch/module.so" "$scratch/backend.o" "$scratch/emulator.o" \
        "$build/common/libcommon.a" >"$scratch/log" 2>&1 || return 2
    CK_RUN_CASE=$1 RIPNERF_CUDA_MODULE=$scratch/module.so "$build/tests/ops/device_test" \
        >"$scratch/log" 2>&1 || return 1
}

# try RUN CASE FILE WHAT SED_SCRIPT
try() {
    local run=$1 case=$2 file=$3 what=$4 script=$5
    number=$((number + 1))
    [[ $number -ge $from ]] || return
    edit "$file" "$number: $what" "$script" "$run" "$case" "$file"
}
# mutate CASE FILE WHAT SED_SCRIPT: of the kernels, of the engine.
mutate() {
    try run "$1" "server/engine/cuda/$2" "$3" "$4"
}
mutate_engine() {
    try run_engine "$1" "server/engine/$2" "$3" "$4"
}

if ! $dry; then
    mkdir "$source"
    cp -r --parents common server tests/ops tests/support "$source"
    compile emulator.o emulator.cpp || give_up "the emulator does not build"
fi

# Synchronisation.
mutate order network.cuh "weights: no barrier after the asynchronous copies" \
    's/^    __syncthreads();//'
mutate order network.cuh "weights: copies not waited for" 's/^    rn_copy_wait<0>();//'
mutate order network.cuh "weights: copies not committed" 's/^    rn_copy_commit();//'
mutate order network.cuh "weights: waited for before they are committed" \
    's/^    rn_copy_commit();/    rn_copy_wait<0>();/;t;s/^    rn_copy_wait<0>();/    rn_copy_commit();/'
mutate order optimise.cuh "pooling: no barrier between update and pooling" \
    's/^    __syncthreads();//'
mutate order step.cuh "order: no barrier before the sums are read" \
    '0,/^    __syncthreads();/s/^    __syncthreads();//'
mutate order step.cuh "order: no barrier after the scan" \
    '/rn_take_sums(&b, &all);/,/int first = /s/^    __syncthreads();//'
mutate order step.cuh "order: lanes' sums are read before they are there" 's/^        __syncwarp();//'
mutate gradients step.cuh "order: rays of a warp share their places" 's/\.first = first + before;/.first = first;/'
mutate many step.cuh "order: rays behind a warp's first 32 share their places" 's/^        first += rn_shuffle.*//'
mutate many step.cuh "order: rays with samples share their places" 's/b.pieces\[piece + pieces_before + i\]/b.pieces[piece + i]/'
mutate many step.cuh "order: rays with samples beyond a warp's first 32" 's/^        piece += rn_shuffle.*//'
mutate many step.cuh "order: a ray's first piece only" 's/i < pieces; i++/i < 1 \&\& i < pieces; i++/'
mutate many step.cuh "order: every piece begins with the ray" 's/{own, i \* RN_PIECE}/{own, 0}/'
mutate many step.cuh "order: pieces of one warp's rays alone" 's/sums\[i\]\[0\].pieces = pieces;/sums[i][0].pieces = 0;/'
mutate gradients step.cuh "order: samples of a tile share their places" 's/ + rn_popcount(rows & (bit - 1));/;/'
mutate gradients step.cuh "order: a ray's tiles share their places" 's/ - b.tile_behind\[slot\] / - rn_popcount(rows) /'
mutate march occupancy.cuh "occupancy: no barrier in the sum" 's/^        __syncthreads();//'
mutate march occupancy.cuh "occupancy: no barrier in the sum's last warp" \
    's/^        __syncthreads();/        if (half >= 32) __syncthreads();/'
mutate order forward.cuh "forward: a lane leaves before its warp" \
    's/if (walk.k >= walk.end) return;/if (RN_LANE == 31) return;/'
mutate gradients loss.cuh "order: what has no gradient is backpropagated" \
    's/if (size == 0 || RN_LANE >= RN_TILE)/if (RN_LANE >= RN_TILE)/'
mutate many gradient.cuh "gradient: a tile is read before it is there" \
    's/rn_copy_wait<RN_GRADIENT_STAGES - 2>/rn_copy_wait<RN_GRADIENT_STAGES - 1>/'
mutate many gradient.cuh "gradient: no barrier before a tile is read" 's|^        __syncthreads(); // this tile.*||'
mutate many gradient.cuh "gradient: the tile under way is overwritten" 's/int ahead = slot > 0 ? .*/int ahead = slot;/'
mutate chip network.cuh "on chip: no barrier before other warps' tiles are read" 's|^    __syncthreads(); // all are there||'
mutate chip network.cuh "on chip: tiles are overwritten that others still read" 's|^    __syncthreads(); // all have read.*||'
mutate chip network.cuh "on chip: the last warp's tile left out" 's/w < warps \&\& warp < WT/w + 1 < warps \&\& warp < WT/'
mutate chip backward.cuh "on chip: all blocks' sums in one place" 's/sums + (size_t)blockIdx.x \* rn_cuda/sums + rn_cuda/'
mutate chip layout.h "on chip: one block's sums alone are added" 's/chunks.first\[n->hidden\] + on_chip;/chunks.first[n->hidden] + 1;/'
mutate chip field.cu "on chip: with the threads of two tiles a warp" 's/int tiles = f->two_tiles \&\& !on_chip/int tiles = f->two_tiles/'
mutate tiles network.cuh "two tiles: products of the first for both" 's/rn_mma(c\[t\]\[0\], a\[t\]\[k\]/rn_mma(c[t][0], a[0][k]/'
mutate tiles network.cuh "two tiles: the first's signs for both" 's/masks\[l - 1\]\[i \/ WORDS\]\[i % WORDS\] = mask\[i \/ WORDS\]/masks[l - 1][i \/ WORDS][i % WORDS] = mask[0]/'
mutate tiles network.cuh "two tiles: both in one place" 's/layer + (place + (size_t)t)/layer + place/'
mutate tiles backward.cuh "two tiles: the second one left out" 's/return T > 1 \&\& tiles - tile < T ? (int)(tiles - tile) : T;/return 1;/'
mutate tiles backward.cuh "two tiles: the first's samples for both" 's/rn_returned_rows(\&batch, count, tile + t, samples/rn_returned_rows(\&batch, count, tile, samples/'
mutate tiles backward.cuh "two tiles: the first's gradients of the density for both" 's/rn_set_column(c\[t\], 0, logit\[t\])/rn_set_column(c[t], 0, logit[0])/'
mutate tiles backward.cuh "two tiles: features' gradients of both in one place" 's/((size_t)(tile + t) \* KT + k)/((size_t)tile * KT + k)/'
mutate tiles backward.cuh "two tiles: as far apart as one" 's/tile = T \* rn_first_tile()/tile = rn_first_tile()/'
mutate tiles field.cu "two tiles: without regard to shared memory" 's/return s->all ? s->tiles : 0;/return s->tiles;/'
mutate gradients gradient.cuh "gradient: every part is a layer's first" 's/int chunk = (int)blockIdx.x - chunks.first\[layer\]/int chunk = 0/'
mutate many gradient.cuh "gradient: groups that are not committed" 's/^    rn_copy_commit();//'
mutate gradients gradient.cuh "gradient: chunks that overlap" \
    's/end = tiles \* (size_t)(chunk + 1)/end = 1 + tiles * (size_t)(chunk + 1)/'
mutate paper field.cu "launch: shared memory that was not asked for" 's/^    RN_TRY(allow_shared(d, kernel));//'
# March.
mutate march march.cuh "march: a brick skipped too far" \
    's/return next > k ? next : k + 1;/return next > k ? next + 1 : k + 2;/'
mutate march march.cuh "march: taken samples are not taken off" 's/w->bits &= w->bits - 1;/w->bits = 0;/'
mutate march march.cuh "march: the window of a wide sample is not aligned" \
    's/w->window = w->k & -(1 << w->shift);/w->window = w->k;/'
mutate march occupancy.cuh "occupancy: bits of y and x exchanged" \
    's/{x0 + i % 8, y0 + i \/ 8, z}/{x0 + i \/ 8, y0 + i % 8, z}/'
mutate march occupancy.cuh "occupancy: distance along two axes only" \
    's/int stride = axis == 0 ? bricks \* bricks/int stride = axis == 0 ? bricks/'
mutate march forward.cuh "compositing: the stop is not looked at" \
    's/before <= stop_depth ? expf(-before) : 0/expf(-before)/'
mutate march occupancy.cuh "occupancy: another limit than asked for" 's/mean < o.limit ? mean : o.limit/mean < RN_OCCUPANCY_LIMIT ? mean : RN_OCCUPANCY_LIMIT/'
mutate march backend.cu "rendering: a field at rest is marched as in training" 's/f->seen.occupancy = f->finer\[view->cells\];/;/'
# Encoding and networks.
mutate gradients encode.cuh "encode: levels exchanged" \
    's/p->map\[c.ly\]\[c.lx\]/p->map[c.lx][c.ly]/'
mutate gradients ../field/ripmap.h "encode: corners at the edges" \
    's/p \* half + (half - CONSTANT(0.5))/p * half + half/'
mutate gradients encode.cuh "encode: rows exchanged" 's/(k \& 2 ? down : 0)/(k \& 2 ? 0 : down)/'
mutate gradients encode.cuh "encode: one row's query for both" 's/rn_find_corner(p, \&q\[i\], of_map/rn_find_corner(p, \&q[0], of_map/'
mutate gradients encode.cuh "encode: the two fragments of a turn exchanged" 's/own\[k % 2\]\[i\] : a/own[1 - k % 2][i] : a/'
mutate gradients encode.cuh "encode: planes with levels looked up without" 's/corner < 4; corner++/corner < 1; corner++/'
mutate gradients encode.cuh "encode: corners that not all lanes have are left out" 's/if (rn_ballot(of_map\[0\] > 0 || of_map\[1\] > 0))/if (!rn_ballot(!(of_map[0] > 0 || of_map[1] > 0)))/'
mutate gradients network.cuh "network: ReLU without its mask in the backward" \
    's/if (MODE == RN_LAYER_MASKED \&\& .*//'
mutate gradients network.cuh "network: masks of another layer" \
    's/\(mask\[i \/ WORDS\]\[i % WORDS\] = masks\[l\) - 1\]/\1]/'
mutate gradients network.cuh "network: activations kept without transposing" \
    's/t.y = rn_transpose(a\[j\]\[1\])/t.y = a[j][1]/'
mutate gradients gradient.cuh "gradient: halves of a fragment exchanged" \
    's/a\[i\]\[1\] = t.z;/a[i][1] = t.y;/;s/a\[i\]\[2\] = t.y;/a[i][2] = t.z;/'
mutate gradients backward.cuh "backward: the logit's gradient left out" \
    's/^        rn_set_column(c\[t\], 0, logit\[t\]);//'
mutate gradients forward.cuh "forward: no constant input" 's/rn_pack(first ? 1 : c\[0\]\[0\]/rn_pack(c[0][0]/'
mutate gradients loss.cuh "compositing: nothing of what lies behind" \
    's/ - (float)(\*behind + (double)rest)//'
mutate gradients loss.cuh "compositing: behind within a tile only" 's/^    \*behind += .*//'
mutate gradients layout.h "fragments: channels in another order" 's/(k \/ 16 % 2) + 2 \* high + q % 2/(k \/ 16 % 2) + high + 2 * (q % 2)/'
mutate gradients layout.h "fragments: a lane's two fragments exchanged" 's/feature \/ 32 \* 2 + feature \/ 4 % 2/feature \/ 32 * 2 + 1 - feature \/ 4 % 2/'
mutate pixels forward.cuh "ray shading: features of half the samples" \
    's/ + (high != 0 ? high \* b : 0);/;/'
mutate pixels forward.cuh "ray shading: diffuse colours rotated" 's/(c + 1) % 2\], (c + 1) \/ 2/c % 2], c \/ 2/'
mutate pixels forward.cuh "ray shading: no opacity in the input" \
    's/out\[0\]\[i\] = column == 0 ? 1 :/out[0][i] = column == 0 ? 0 :/'
mutate pixels shade.cuh "ray shading: a colour without its opacity" 's/+= opacity \* colour/+= colour/'
mutate places step.cuh "rendering: opacity as blue" 's/four\[2\]}, four\[3\], 0}/four[2]}, four[2], 0}/'
mutate parts backend.cu "rendering: a part is taken before it is there" 's/d->staged\[(part + 1) % 2\], before/d->staged[part % 2], before/'
mutate parts backend.cu "rendering: the last part is not taken" 's/^        e = queue_part(f, p, part, \&count);/&\n        if (count == 0) break;/'
mutate parts backend.cu "rendering: samples of the last part only" 's/counts_anew = part == 0/counts_anew = true/'
mutate march forward.cuh "ray shading: a turned ray keeps its direction" \
    's/march->turned ? march->look\[i\] : //'
mutate rays loss.cuh "ray shading: behind within a tile only" 's/^    \*behind += .*//'
mutate rays shade.cuh "ray shading: the last tile only" \
    's/slot >= 0; slot = b->tile_previous\[slot\]/slot >= 0; slot = -1/'
mutate rays shade.cuh "ray shading: no gradient of the opacity" 's/^        g.opacity += .*//'
mutate rays loss.cuh "ray shading: the background takes no part" 's/^    rn_colour_back_lane(.*//'
mutate rays shade.cuh "ray shading: no gradient of the diffuse colours" \
    's/^        rn_set_column(direct, 1 + k.*/;/'
mutate rays shade.cuh "ray shading: nothing through the colour network" \
    's/= c\[i \/ 4\]\[i % 4\] + direct/= direct/'
mutate rays shade.cuh "ray shading: diffuse colours without their sigmoid" \
    's/bool activated = .*/bool activated = false;/'
mutate rays shade.cuh "ray shading: samples without their weights" 's/ \*= of_row;/ *= of_row > 0;/'
mutate rays shade.cuh "ray shading: weights of the other half of a tile" 's/weight, RN_LANE \/ 4 + 8 \* i/weight, RN_LANE \/ 4 + 8 - 8 * i/'
mutate rays shade.cuh "ray shading: directions of the tile's first ray" \
    's/rn_direction_of(b, r), look/rn_direction_of(b, r - RN_LANE \/ 4), look/'
mutate rays shade.cuh "ray shading: every tile in the same place" 's/\&scratch, tile, 1, in/\&scratch, 0, 1, in/'
mutate second shade.cuh "ray shading: rays of the step before take part" \
    's/bool is = RN_LANE < RN_TILE .*/bool is = RN_LANE < RN_TILE;/'
mutate second gradient.cuh "ray shading: as many tiles of rays as of samples" 's/of_rays ? .* : status->returned/status->returned/'
mutate roulette loss.cuh "roulette: what is drawn counts once" 's/\*ret_factor = chance > 0 ? .*/*ret_factor = chance > 0;/'
mutate roulette loss.cuh "roulette: what is likelier than not is backpropagated" \
    's/return before \/ RN_CERTAIN != after \/ RN_CERTAIN;/return chance > RN_CERTAIN \/ 2;/'
mutate roulette loss.cuh "roulette: the same start for all rays" 's/    l.sum = rn_rng_draw.*/    l.sum = RN_CERTAIN - 1;/'
mutate roulette step.cuh "roulette: the mean is of scaled gradients" 's| / (float)all->gradients / s->gradient_scale| / (float)all->gradients|'
mutate roulette loss.cuh "roulette: colours' gradients count once" 's/factor \* sigmoid\[c\]/sigmoid[c]/'
mutate gradients loss.cuh "loss: a split pixel is its first ray" 's/r - r % rays, rays)/r - r % rays, 1)/'
mutate gradients loss.cuh "loss: every ray of a split pixel has all of its weight" 's/share \* ray->weight/ray->weight/'
mutate roulette backend.cu "roulette: none" 's/f->batch.roulette = .*/f->batch.roulette = 0;/'
mutate_engine bytes train/saving.c "engine: the gradients' size is forgotten" \
    's/    t->device.gradient_size = from->gradient_size;//'
mutate guards shade.cuh "ray shading: a ray that is not finite reaches the weights" \
    's/^                rn_keep_rows(in.*//'
# Scatter and update.
mutate gradients scatter.cuh "scatter: a moved nest loses a column" 's/^        if (!stays)$/        if (!stays \&\& k % 2 == 0)/'
mutate gradients scatter.cuh "scatter: the first four channels for all" 's/p->planes->channels + p->channel;/p->planes->channels;/'
mutate gradients scatter.cuh "scatter: levels exchanged" 's/float4{q.x.p, q.y.p, lx, ly}/float4{q.x.p, q.y.p, ly, lx}/'
mutate gradients scatter.cuh "scatter: only the first block is marked" 's/if (marked\[0\] == .*/if (marked[0] >= 0) return;/'
mutate gradients scatter.cuh "scatter: not flushed at the end" 's/if (i > count) break;/if (i >= count) break;/'
mutate gradients scatter.cuh "scatter: levels change without a flush" \
    's/bool leaves = ends || .*/bool leaves = ends;/'
mutate gradients scatter.cuh "scatter: blocks not marked as touched" 's/if (moved \&\& p->channel == 0) rn_mark.*/;/'
mutate many scatter.cuh "scatter: every piece is a ray's first" 's/returned.first + piece.begin, left/returned.first, left/'
mutate many scatter.cuh "scatter: pieces that overlap" 's/left < RN_PIECE ? left : RN_PIECE/left/'
mutate sparse optimise.cuh "update: sparse visits all blocks" 's/(sparse \& !touched)/(0 \& !touched)/'
mutate sparse backend.cu "update: dense where there are levels" 's/ c->sparse \&\& .*,$/ c->sparse \&\& f->scene.planes.levels == 1,/'
mutate whole backend.cu "update: voxels beside uneven planes are visited where samples met them" 's/ \&\& !f->scene.planes.shares,$/,/'
mutate gradients optimise.cuh "pull-down: no weight for the level" 's/(1 << (k % 4 + k \/ 4))/(1 << (k % 4))/'
mutate gradients optimise.cuh "pull-down: what does not exist hands down too" 's/exists ? weight \* found\[k\]\[c\] : 0/weight * found[k][c]/'
mutate gradients optimise.cuh "pooling: rows with the wrong neighbours" 's/quads << (lx - 1)/quads << lx/'
mutate gradients optimise.cuh "pooling: columns of every second row" 's/mean\[2 \* y + 1\]\[c\]/mean[2 * y][c]/'
try run_trained paper server/engine/cuda/optimise.cuh "update: gradients not cleared" 's/{&scene, &o.gradients, b, touched}/{\&scene, \&o.gradients, b, false}/'
mutate second optimise.cuh "update: the maps get the moments" \
    's/rn_pool_block<FIXED>(&to, own.value)/rn_pool_block<FIXED>(\&to, own.m)/'
mutate gradients optimise.cuh "AdamW: decay left out" 's/\*p \* a->decay/0/'
mutate occupancy occupancy.cuh "occupancy: measured cells do not decay" 's/ \* m.decay;/;/'
mutate uneven uneven.cuh "uneven: one texel of a level alone gets a gradient back" 's/k < 4; k++/k < 1; k++/'
mutate uneven layout.h "uneven: an odd line halves as an even one" 's/rn_rip_taps(size, of, /rn_rip_taps(size \& ~1, of, /'
mutate second uneven.cuh "uneven: gradients not cleared" 's/g.fixed\[at + c\] = 0;/;/;s/g.half\[at \/ 4\] = uint2{0, 0};/;/'
mutate uneven uneven.cuh "uneven: a texel of the base counts once" 's/share->first + 1 == of ? share->weight\[1\] : 0/0/'
# What a card with less shared memory, and a graph that froze its arguments, show.
mutate cards field.cu "shared memory: two networks staged where one fits" \
    's/if (both <= device->shared_bytes)/if (one <= device->shared_bytes)/'
mutate cards forward.cuh "shared memory: the colour network staged where only the other fits" \
    's/t.head = rn_stage(SHARED || staged > 1,/t.head = rn_stage(SHARED || staged > 0,/'
mutate cards backward.cuh "shared memory: staged where nothing fits" 's/rn_stage(SHARED || staged > 0,/rn_stage(true,/'
mutate learning backend.cu "graph: captured before the march is known" \
    's/if (!e) e = capture_step(f);/float s = f->march.step; f->march.step = 0; if (!e) e = capture_step(f); f->march.step = s;/'
mutate cards field.cu "shared memory: kernels for all of it where a part fits" 's/train\[staging.all\]/train[staging.networks > 0]/g'
# Which rays the forward takes.
mutate march march.cuh "queue: a ray that meets one brick is left out" 's/^    int tiles = 0;/    int tiles = -1;/'
mutate march march.cuh "queue: bricks counted from too far on" 's/w.k = next == w.k ? w.k + (RN_TILE << w.shift) : next;/w.k = next + (RN_TILE << w.shift);/'
mutate march march.cuh "queue: short rays are not taken" 's/while (l < RN_LENGTHS \&\& at >=/while (l < RN_LENGTHS - 1 \&\& at >=/;s/if (l < RN_LENGTHS) ray/if (l < RN_LENGTHS - 1) ray/'
mutate march march.cuh "queue: rays of a warp share their places" 's/first + rn_popcount(mine \& ((1u << RN_LANE) - 1))/first/'
mutate march step.cuh "queue: pixels of nothing are black" 's/{c\[0\], c\[1\], c\[2\]}, 0, 0}/{0, 0, 0}, 0, 0}/'
mutate second step.cuh "queue: rays of the step before are taken again" 's/^        s->queued\[l\] = 0;/        ;/'
mutate parts field.cu "queue: pixels of the part before are taken again" 's/^    RN_TRY(cudaMemsetAsync(f->view.status->queued.*//'
mutate second step.cuh "queue: an empty ray keeps what another left" 's/if (tiles == 0) rn_leave_empty(.*/;/'
mutate places step.cuh "rendering: pixels as they lie, whatever list" 's/view.places ? view.places\[pixel\] : view.first/view.first/'
mutate places step.cuh "rendering: every picture through the first camera" 's/view.cameras\[place .*\];/view.cameras[0];/'
mutate places step.cuh "rendering: one cone instead of four" 's/x \* n + cone % n + 0.5/x * n + 0.5/'
mutate march step.cuh "rendering: rays that end early stay open" 's/^        rn_close_ended.*/        ;/'
mutate places step.cuh "rendering: straight colours are averaged as others" 's/view.straight ? march.colour.background : NULL/NULL/'
mutate parts backend.cu "rendering: the list of the first part again" 's/p->places->numbers + p->asked/p->places->numbers/'
mutate parts backend.cu "rendering: copied before it is there" 's/^    if (!e) e = cudaStreamWaitEvent.*//'
mutate parts backend.cu "rendering: all parts in one place" 's/march, f->parts\[stage\])/march, f->parts[0])/'
# Cells by lot.
mutate occupancy occupancy.cuh "occupancy: another coin" 's/rn_cell_draw(\&m, cell).v\[3\]/rn_cell_draw(\&m, cell).v[2]/'
mutate occupancy occupancy.cuh "occupancy: occupied cells are not counted" 's/^    if (bits) atomicAdd(&o.cells_now->occupied.*//'
mutate occupancy occupancy.cuh "occupancy: every cell counts as empty" 's/chance\[rn_cell_is_set(\&o, cell)\]/chance[0]/'
mutate occupancy field.cu "occupancy: cells of the turn are measured, not those drawn" 's/f->steps};/f->steps}; m.drawn = false;/'
# Places, and voxels.
mutate unbounded space.cuh "bent rays: steps of half their length" 's/k \* (2 \* step) + (2 - ray->length)/k * step + (2 - ray->length)/'
mutate worlds march.cuh "bent rays: cells looked up where the ray is straight" 's/p \*= scale;/p *= 0.5f;/'
mutate bent march.cuh "bent rays: skipped beyond what is empty" 's/margin \* 0.999f/margin * 1.5/'
mutate unbounded encode.cuh "unbounded: footprints as before the contraction" 's/float r = size <= 1 ? .*/float r = 1;/'
mutate unbounded encode.cuh "unbounded: samples far away as long as those near by" 's/fmaxf(s \* s, 1) \* (2 \* step)/2 * step/'
mutate unbounded forward.cuh "end of a place: something shines through" 's/if (rn_ends<WORLD>() \&\& last)/if (false)/'
try run_trained agrees server/engine/cuda/encode.cuh "self-check: places without their contraction" 's/float scale = rn_lengths_at(ray, s).scale, width/float scale = 0.5f, width/'
mutate worlds forward.cuh "end of a place: behind what ended a ray, too" 's/depth + (double)all <= (double)stop_depth \&\& //'
mutate cells occupancy.cuh "cells of a place: kept as a ball's are" 's/o.by_sight ? RN_SEEN_LIMIT : //'
try run_trained hidden server/engine/cuda/forward.cuh "cells of a place: what is hidden shows itself" 's/^    if (!(s->before <= RN_HIDDEN_DEPTH)) return;//'
mutate cells occupancy.cuh "cells of a place: its end may be empty" 's/if (o.by_sight \&\& !over) over = .*//'
mutate cells occupancy.cuh "cells of a place: every round has all that came before" 's/^    seen\[i\] = 0;//'
mutate cells backend.cu "cells of a place: what they showed before is forgotten" 's/if (!e \&\& t->seen \&\& f->batch.seen)/if (false)/'
mutate_engine "place shown" train/device.c "engine: what cells showed does not follow to the device" 's/\.seen = t->hull.seen}/.seen = NULL}/'
mutate unbounded loss.cuh "distortion: behind within a tile only" 's/^    d->behind += .*//'
mutate unbounded loss.cuh "distortion: in distances, not in places" 's/0.5f \* rn_place_of_distance_lane(mid)/mid/'
mutate unbounded loss.cuh "distortion: every ray of a split pixel has all of its weight" 's|rays\].weight / (float)rays;|rays].weight;|'
mutate voxels field.cu "distortion in a ball: in places, as along bent rays" 's/: f->world == RN_WORLD_UNBOUNDED ? KERNEL<RN_DISTORTS_PLACES>/: true ? KERNEL<RN_DISTORTS_PLACES>/'
try run_trained "window step" server/engine/cuda/field.cu "distortion in a disparity box: in places, as along bent rays" 's/: f->world == RN_WORLD_UNBOUNDED ? KERNEL<RN_DISTORTS_PLACES>/: true ? KERNEL<RN_DISTORTS_PLACES>/'
mutate voxels encode.cuh "voxels: weights of x along z" 's/corner \& 4 ? q->z : 1 - q->z/corner \& 4 ? q->x : 1 - q->x/'
mutate voxels scatter.cuh "voxels: left without being written" 's/if (voxel != held) rn_flush_voxel.*/;/'
mutate voxels field.cu "voxels: not updated" 's/^    RN_TRY(queue_voxels<FIXED>(f));//'
mutate second optimise.cuh "voxels: gradients not cleared" 's/^            o.gradients.voxels\[own + c\] = 0;//'
mutate smoothing optimise.cuh "smoothing: voxels of a slice alone" 's/at\[z > 0 ? -slice : 0\]/at[0]/'
mutate smoothing field.cu "smoothing: voxels as far as texels" 's/share \* (4.0f \/ 6)/share/'
# Where rays come from.
try run_trained masks server/engine/cuda/step.cuh "rays: from pixels that are left out, too" 's/^    if (!rn_is_used(p, pixel)) return out;//'
try run_trained masks server/engine/cuda/step.cuh "rays: another pixel's bit" 's/>> pixel % 32 \& 1/>> (31 - pixel % 32) \& 1/'
mutate_engine outliers train/device.c "engine: outliers do not follow to the device" 's/if (rn_trainer_is_drawn(t, frame, x, y))/if (rn_pixel_is_used(\&t->train, frame, x, y))/'
mutate_engine "masked views" train/device.c "engine: what masks leave out is scored" 's/if (rn_pixel_is_used(&t->held, frame, x, y))/if (true)/'
mutate_engine moved train/device.c "engine: cameras stay where they were given" 's/{.camera = from->camera,/{.camera = from->frame->camera,/'
mutate_engine turn train/trainer.c "engine: cameras are moved by the field that the host had before" '/^enum rn_status rn_trainer_enter/,/^}/s/rn_trainer_fetch(t, err)/RN_OK/'
try run_trained "error step" server/engine/kernels/draw.h "by errors: rays of blocks that are drawn often weigh as others" 's/\*ret_weight = 1 \/ .*/*ret_weight = 1;/'
try run_trained "error step" server/engine/cuda/step.cuh "by errors: every block alike" 's/? rn_shared_pixel(.*/? rn_live_pixel(s->seed, from.turn, count)/'
try run_trained "error step" server/engine/cuda/step.cuh "by errors: losses in the order of arrival" 's/if (i > done \&\& i < next) next = i;/if (i > done) next = i;/'
try run_trained "error step" server/engine/cuda/step.cuh "by errors: the loss of one ray of a block" 's/^        done = next;/        done = b.ray_capacity;/'
try run_trained "error step" server/engine/cuda/step.cuh "by errors: every ray of a split pixel is noted" 's/r % b->pixel_rays ? -1 : block/block/'
mutate_engine errors train/device.c "engine: shares stay as they began" 's/shares_are_due(t) ? share_out(t, err) : RN_OK/RN_OK/'
mutate_engine "error bytes" train/device.c "engine: new shares do not reach the device" 's/return t->field->backend->train_share(on, &shares, err);/return RN_OK;/'
mutate_engine "error bytes" train/device.c "engine: errors are not read back for a checkpoint" '/^enum rn_status rn_trainer_fetch/,/^}/s/.block_error = t->sampler.importance.error/.block_error = NULL/'
try run_trained "mip step" server/engine/cuda/encode.cuh "mip: the level of one axis" 's/lx = ly = 0.5f \* (lx + ly);/ly = lx;/'
# Guards.
mutate guards scene.cuh "a step that overflowed updates all the same" \
    's/return s->rejected || !(s->weight > 0);/return !(s->weight > 0);/'
mutate guards step.cuh "a crowded step counts as one of bad numbers" 's/if (!s->crowded) {/if (1) {/'
mutate guards step.cuh "too many tiles not noticed" 's/s->crowded = s->tiles > b->tile_capacity/s->crowded = 0/'
mutate guards step.cuh "the gradients' scale stays after an overflow" 's/s->gradient_scale \* 0.5f/s->gradient_scale/'
mutate guards backend.cu "memory taken without counting" 's/if (need <= budget_bytes) {/if (true) {/'
# The engine with a device.
mutate_engine standard train/trainer.c "engine: what the host decided stays on the host" \
    's|^    return rn_trainer_put(t, err);|    return RN_OK;|'
mutate_engine standard train/device.c "engine: Adam counts from 0 after growth" \
    's/    t->optimiser.updates = p->updates;//'
mutate_engine standard train/device.c "engine: planes at the networks' rate" \
    's/rate \* config->plane_rate/rate/'
mutate_engine standard train/device.c "engine: occupancy measured at no step" \
    's/.measure = turn.due,/.measure = false,/'
mutate_engine standard train/device.c "engine: moments do not follow to the device" \
    's/\.m = t->optimiser.m,/.m = NULL,/;s/\.v = t->optimiser.v,/.v = NULL,/'
mutate_engine standard scene/device.c "engine: moments are not read back" \
    's/if (training) numbers = \*training;/if (training) numbers.seen = training->seen;/'
mutate_engine paper train/device.c "engine: samples counted twice" \
    's/    t->device.counted = p;//'
mutate_engine bytes train/saving.c "engine: the gradients' scale is forgotten" \
    's/    t->device.good_steps = from->good_steps;//'
mutate_engine bytes train/device.c "engine: a resumed run draws its first rays again" \
    's/\.step = t->progress.step,/.step = 1,/'
mutate_engine renders scene/device.c "engine: parameters read back once only" \
    's/    if (!f->on_device || .*return RN_OK;/    static int once; if (!f->on_device || once++) return RN_OK;/'
mutate_engine renders scene/device.c "engine: pyramid not built anew after reading back" \
    's/    f->fresh_levels = 0;//;s/    f->packed_for = NULL;//'
mutate_engine renders scene/device.c "engine: occupancy not read back" \
    's/numbers.occupancy = f->occupancy;/;/'
mutate_engine renders render/render.c "engine: a far camera rendered with too few levels" \
    's/levels <= f->field->device_levels/true/'
mutate_engine renders render/render.c "engine: traced points in each other's places" 's/f->lattice.pixels\[t->listed\[i\]\]/f->lattice.pixels[i]/'
mutate_engine together render/render.c "engine: points of pictures that are traced together are the first one's" 's/f->first_point + (uint32_t)(spots/(uint32_t)(spots/'
mutate_engine together render/render.c "engine: all of one call are seen by the first camera" 's/cameras\[i\] = f\[i\].camera;/cameras[i] = f->camera;/'
mutate_engine together render/render.c "engine: a picture of another tolerance goes with the first" 's/f->tolerance == first->tolerance \&\& //'
mutate_engine renders render/render.c "engine: no tolerance on a device" 's/if (rn_lattice_passes(&f->lattice) == 1)/if (true)/'
mutate_engine rest scene/device.c "engine: firm cells in place of all finer ones" 's/finer\[RN_CELLS_FINE\] = &f->fine;/finer[RN_CELLS_FINE] = \&f->firm;/'
mutate_engine rest render/render.c "engine: a picture's cells are not chosen for a device" \
    's/^    rn_field_choose_cells/    if (!f->on_device) rn_field_choose_cells/'
mutate_engine paper train/device.c "engine: held-out views over black" \
    's/^    march.straight = .*/    memset(\&march.colour, 0, sizeof march.colour);/'
mutate_engine diverges train/device.c "engine: never back to good numbers" \
    's/p.rejected_in_a_row < MOST_REJECTED ? RN_OK : roll_back(t, err)/RN_OK/'
mutate_engine diverges train/device.c "engine: the device keeps what training went back from" \
    's/    return rn_trainer_put(t, err);/    return RN_OK;/'
mutate_engine memory scene/device.c "engine: memory taken without asking" \
    's/enum rn_status status = make_room(.*/enum rn_status status = RN_OK;/'
mutate_engine auto scene/device.c "engine: auto insists" \
    's/if (engine->device_optional \&\& /if (0 \&\& /'
# A training's validation.
mutate_engine validates train/device.c "validation: photographs of any size in one call" 's/if (f->camera.width != width || f->camera.height != height) break;//'
mutate_engine validates train/device.c "validation: errors of all photographs in the first" 's/\&ret_squares\[i \/ each\]/ret_squares/'
mutate_engine validates train/device.c "validation: rows of the first part" 's/y = row + (int)(i % each/y = (int)(i % each/'
mutate_engine validates train/device.c "validation: no look at how many cones there are" 's/all \* (size_t)(count + 1) <= RN_VALIDATE_CONES/all > 0/'
mutate_engine validates train/validate.c "validation: the last photograph left out" 's/for (int i = 0; i < count \&\& status/for (int i = 0; i + 1 < count \&\& status/'

conclude
