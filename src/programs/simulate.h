// A contact model as a black box that speaks the protocol of blackbox/protocol.h.
#pragma once

namespace saltus {

// `saltus_simulate`.
int SimulateMain(int argc, char** argv);

}  // namespace saltus
