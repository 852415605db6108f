// saltus_sweep: many points of some options, on all cores and many machines, with every finished point kept.
#pragma once

namespace saltus {

int SweepMain(int argc, char** argv);

}  // namespace saltus
