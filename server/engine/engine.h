// The engine: a radiance field on one device. What the runner drives; no HTTP, no JSON, no
// policy about when to train or render.
//
// One thread calls into an engine and everything made from it (the engine has its own worker
// threads inside). Work is cut into blocks of a few milliseconds: rn_trainer_advance and
// rn_trainer_validate return after `budget_ms`, or when the thread is preempted, so that the caller
// can render or cancel between.
#ifndef RN_SERVER_ENGINE_ENGINE_H
#define RN_SERVER_ENGINE_ENGINE_H

#include "server/engine/checkpoint/checkpoint.h"
#include "server/engine/checkpoint/viewing.h"
#include "server/engine/effects/about.h"
#include "server/engine/render/mesh.h"
#include "server/engine/render/render.h"
#include "server/engine/render/within.h"
#include "server/engine/scene/engine.h"
#include "server/engine/train/train.h"

#endif
