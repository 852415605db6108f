// Simulators and contact models written in Python, as black boxes.
#pragma once

#include <pybind11/pybind11.h>

#include <memory>
#include <optional>
#include <string>

#include "saltus/audit/black_box.h"

namespace saltus::python {

// The answers that it offers besides final states. Gradients are of any function of the final state or, if there is a
// `loss`, of that objective with its effort: then there are none for scenes with another objective.
struct CallableOffer {
  bool gradient = false, step = false, states = false;
  std::optional<Objective> loss = std::nullopt;
};

// A black box that calls `answerer`(kind, scene, dt, initial, control, of_final), kind being "simulate", "gradient" or
// "step"; dt is the length of a step, s, and arrays are (B, 4), (K, C, 2) or, of a step, (B, 2), and (B, 4). It returns
// a dict with "final state" and perhaps "states" (K + 1, B, 4), and of a gradient "gradient by the initial state" and
// "gradient by the control". What it raises ends the computation that is under way in the thread.
std::shared_ptr<BlackBox> MakeCallableBox(const std::string& name, const pybind11::object& answerer,
                                          const CallableOffer& offer);

}  // namespace saltus::python
