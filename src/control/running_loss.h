// What a motion costs on its way: running and via terms of the objective, integrated exactly piece by piece, cut at
// impacts and where targets turn.
#pragma once

#include "saltus/scene/scene.h"
#include "simulate/flight.h"

namespace saltus {

double RunningLoss(const Scene& scene, const Flight& flight);

}  // namespace saltus
