// The simulators of all contact models, compiled in kNumShards translation units that build side by side.
#pragma once

#include <memory>

#include "saltus/dynamics/simulator.h"

namespace saltus {

inline constexpr int kNumShards = SALTUS_NUM_SHARDS;

// The simulator of model number `index` of ContactModels. Precondition: index % kNumShards == kShard.
template <int kShard>
std::unique_ptr<Simulator> MakeInShard(int index, const Scene& scene, Precision precision);

}  // namespace saltus
