// Simulators and contact models written in Python, as black boxes.
#pragma once

#include <pybind11/pybind11.h>

#include <memory>
#include <string>

#include "saltus/audit/black_box.h"

namespace saltus::python {

// A black box that calls `answerer`(kind, scene, dt, initial, control, of_final), kind being "simulate", "gradient" or
// "step"; dt is the length of a step, s, and arrays are (B, 4), (K, C, 2) or, of a step, (B, 2), and (B, 4). It returns
// a dict with "final state" and perhaps "states" (K + 1, B, 4), and of a gradient "gradient by the initial state" and
// "gradient by the control". What it raises ends the computation that is under way in the thread.
std::shared_ptr<BlackBox> MakeCallableBox(const std::string& name, const pybind11::object& answerer, bool gradient,
                                          bool step, bool states);

}  // namespace saltus::python
