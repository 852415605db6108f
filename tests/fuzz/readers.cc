#include "fuzz/targets.h"

namespace saltus::fuzz {

std::span<const Target> Targets() {
  static constexpr Target kTargets[] = {{"scene", ReadsScene},
                                        {"sweep", ReadsSweep},
                                        {"points", ReadsPoints},
                                        {"given", ReadsGiven},
                                        {"sequence", ReadsSequence},
                                        {"npy", ReadsNpy},
                                        {"npz", ReadsNpz}};
  return kTargets;
}

}  // namespace saltus::fuzz
