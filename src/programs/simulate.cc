// `saltus_simulate`: a contact model as a black box that speaks the protocol of blackbox/protocol.h.
#include <gflags/gflags.h>

#include <iostream>
#include <string>

#include "blackbox/protocol_server.h"
#include "programs/program.h"

DEFINE_string(offer, "gradient,step,states",
              "answers offered in addition to final states: some of gradient, step and states, or none");
DECLARE_string(contact);
DECLARE_string(precision);

namespace saltus {
namespace {

ServerCapabilities ReadOffer() {
  ServerCapabilities offer{false, false, false};
  if (FLAGS_offer == "none") return offer;
  for (const std::string& name : Split(FLAGS_offer)) {
    bool* given = name == "gradient" ? &offer.gradient : name == "step" ? &offer.step : &offer.states;
    if (given == &offer.states && name != "states") {
      throw InputError("--offer=" + FLAGS_offer + ": found '" + name + "', expected gradient, step, states or none");
    }
    *given = true;
  }
  return offer;
}

}  // namespace

int SimulateMain(int argc, char** argv) {
  return RunMain(argc, argv, FindProgram("saltus_simulate"), [] {
    if (FLAGS_contact == "all") throw InputError("--contact=NAME is needed; saltus_audit --contact=list lists them");
    if (const std::string wrong = Validate(FLAGS_contact); !wrong.empty()) {
      throw InputError("--contact=" + FLAGS_contact + ": " + wrong);
    }
    ProtocolServer speaker(FLAGS_contact, PrecisionFromFlags(), ReadOffer());
    for (std::string line; std::getline(std::cin, line);) {
      if (!line.empty()) std::cout << speaker.ComputeAnswer(line) << std::endl;
    }
    return kDone;
  });
}

}  // namespace saltus
