// A contact model whose points wait until they are let on, so that a test acts when it wants to, on a machine of any
// speed: --contact=gate:number=K leaves the file reached_K in the folder that the environment variable SALTUS_GATES
// names, and goes on once there is open_K.
#pragma once

#include <glog/logging.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>

#include "saltus/contact/contact_model.h"

namespace saltus {

struct Gate {
  static constexpr ModelTraits kTraits = {
      .name = "gate", .summary = "waits, and then touches nothing", .source = "a test"};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  int number = 0;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"number", "which gate", 0, 1000}, number);
  }

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    PassThrough();
    return SemiImplicitEuler(in, i, x);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
  }

  void PassThrough() const {
    const std::string gates = CHECK_NOTNULL(std::getenv("SALTUS_GATES"));
    std::ofstream(gates + "/reached_" + std::to_string(number));
    while (!std::filesystem::exists(gates + "/open_" + std::to_string(number))) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }
};

}  // namespace saltus
