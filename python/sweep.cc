// Points of a sweep, as saltus_sweep computes them.
#include <pybind11/stl.h>

#include <atomic>
#include <cmath>
#include <memory>

#include "computation.h"
#include "convert.h"
#include "saltus/solve/solver.h"
#include "sweep/results.h"
#include "sweep/study.h"

namespace saltus::python {
namespace {

// A study, and whether the points that are computed are to come back early.
struct PythonStudy {
  SweepStudy study;
  std::atomic<bool> stopped{false};
};

std::unique_ptr<PythonStudy> MakeStudy(const Scene& scene, const std::string& grid,
                                       const std::vector<std::string>& contacts,
                                       const std::vector<std::string>& solvers, const std::string& precision,
                                       int iterations, std::optional<double> learning_rate) {
  Request request;
  request.scene = scene;
  for (const std::string& contact : contacts) {
    if (const std::string wrong = Validate(contact); !wrong.empty()) throw py::value_error("contact: " + wrong);
  }
  request.contacts = contacts;
  for (const std::string& solver : solvers) {
    const std::vector<std::string> known = NameList(AllSolvers());
    if (std::ranges::find(known, solver) == known.end()) {
      throw py::value_error("solver: found '" + solver + "', expected one of " + Joined(known));
    }
  }
  request.solvers = solvers;
  request.precision = ReadPrecision(precision);
  if (iterations < 0) throw py::value_error("iterations: expected a number of at least 0");
  request.options.limits.iterations = iterations;
  request.options.sequences.search = true;
  request.options.descent.learning_rate = learning_rate.value_or(DefaultLearningRate(scene));
  if (!(request.options.descent.learning_rate > 0) || !std::isfinite(request.options.descent.learning_rate)) {
    throw py::value_error("learning_rate: expected a finite number > 0");
  }
  try {
    auto study = std::unique_ptr<PythonStudy>(new PythonStudy{SweepStudy(request, ParseSweep(grid, scene))});
    if (study->study.generates()) {
      throw py::value_error("grid: found 'seed', which takes the place of the scene; expected options of the scene");
    }
    return study;
  } catch (const InputError& error) {
    throw py::value_error(error.what());
  }
}

py::dict RowToPython(const SweepStudy& study, const PointResult& result) {
  py::dict row;
  for (size_t i = 0; i < result.row.size(); ++i) row[py::str(study.columns()[i])] = ToPython(result.row[i]);
  row[kStatusColumn] = ToString(result.status);
  return row;
}

}  // namespace

void BindSweep(py::module_* module) {
  py::class_<PythonStudy>(*module, "SweepStudy")
      .def(py::init(&MakeStudy),
           py::arg("scene"),
           py::arg("grid"),
           py::arg("contacts"),
           py::arg("solvers"),
           py::arg("precision"),
           py::arg("iterations"),
           py::arg("learning_rate"))
      .def("__len__", [](const PythonStudy& self) { return self.study.size(); })
      .def("point",
           [](PythonStudy& self, int64_t point, double seconds) {
             if (point < 0 || point >= self.study.size()) throw py::index_error("point: there is none of this number");
             Computation computation;
             PointResult result;
             computation.RunOrThrow([&] {
               const StopRequest stop = [&] { return self.stopped || computation.stop()(); };
               result = ComputePoint(self.study, point, seconds, stop, /*alone=*/false);
             });
             return RowToPython(self.study, result);
           })
      .def("failed",
           [](const PythonStudy& self, int64_t point, const std::string& reason) {
             return RowToPython(self.study, FailedPoint(self.study, point, reason));
           })
      .def("stop", [](PythonStudy& self) { self.stopped = true; });
}

}  // namespace saltus::python
