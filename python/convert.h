// Between C++ and Python: JSON documents, scenes and names.
#pragma once

#include <pybind11/pybind11.h>

#include <span>
#include <string>

#include "programs/json_output.h"
#include "saltus/scene/scene.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"

namespace saltus::python {

namespace py = pybind11;

// dicts, lists, str, int, float, bool and None, with the same bits.
py::object ToPython(const Json& value);

// "double" or "float". ValueError.
Precision ReadPrecision(const std::string& name);

// Raises the SceneError of Python.
[[noreturn]] void Raise(const SceneFileError& error);

// ValueError if a control in rows (control_rows.h) has torques on discs that are not turned.
void CheckRows(const Scene& scene, const std::string& name, std::span<const double> rows);

// ValueError with the reason if the model cannot take the scene.
void CheckTakes(const Contact& contact, const Scene& scene);

// RuntimeWarning with a remark on derivatives, if it is not empty.
void WarnOfRemark(const std::string& remark);

// RuntimeWarning if so many steps of a motion used the time-stepping fallback (simulate/events.h).
void WarnOfUnresolved(int unresolved_steps, int num_steps);

// A contact model by its name, perhaps with options, or one made in Python. ValueError.
Contact ReadContact(const py::handle& contact);

// Reads a surrogate from its keyword arguments, or None. Raises ValueError or TypeError.
std::optional<Surrogate> ReadSurrogate(const py::object& surrogate);

// 0 is one per core. ValueError.
int ReadThreads(int threads);

// The summaries of contact models or solvers, by their names.
template <typename Entries>
py::dict SummariesOf(const Entries& entries) {
  py::dict summaries;
  for (const auto& entry : entries) summaries[py::str(std::string(entry.name))] = std::string(entry.summary);
  return summaries;
}

// Parts of the module.
void BindScene(py::module_* module);
void BindSimulation(py::module_* module);
void BindBatch(py::module_* module);
void BindEndState(py::module_* module);
void BindSolve(py::module_* module);
void BindAudit(py::module_* module);
void BindIdentify(py::module_* module);
void BindContact(py::module_* module);
void BindFeedback(py::module_* module);
void BindHybrid(py::module_* module);
void BindSweep(py::module_* module);

}  // namespace saltus::python
