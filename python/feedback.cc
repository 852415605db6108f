#include "feedback.h"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <array>
#include <stdexcept>
#include <tuple>

#include "arrays.h"
#include "computation.h"
#include "convert.h"
#include "feedback/noisy_states.h"
#include "saltus/control/control_rows.h"
#include "saltus/feedback/filter.h"
#include "saltus/simulate/registry.h"

namespace saltus::python {
namespace {

using Matrices = std::vector<Eigen::MatrixXd>;

// The exact motion of a scene under a control, or under its own; runs are simulated under `contact`, whose steps are
// those of the scene.
PlannedMotion PlanScene(const Scene& scene, const py::object& control, const py::object& contact_name) {
  const Contact contact = ReadContact(contact_name);
  for (const Contact& model : {Contact("event"), contact}) CheckTakes(model, scene);
  if (FindContactModel(contact)->grid_steps != 1) {
    throw py::value_error("contact: '" + contact.name() + "' covers several steps of the scene by one");
  }
  std::vector<double> numbers = InitialControl(scene, scene.steps);
  if (!control.is_none()) {
    const Array rows = ReadArray(control, "plan", {scene.steps, scene.num_controlled(), ControlColumns(scene)});
    CheckRows(scene, "plan", View(rows));
    numbers = ControlOfRows(scene, View(rows));
  }
  PlannedMotion planned;
  Computation().RunOrThrow([&] {
    const auto motion = MakeSimulator("event", scene, Precision::kDouble);
    if (!motion->Rollout(InitialState(scene), numbers)) throw std::runtime_error(motion->WhyFailed());
    planned.plan = MakePlan(*motion, numbers);
    planned.linear = Linearize(*motion, numbers);
  });
  const Eigen::Index n = planned.plan.states.front().size();
  planned.what_is_wrong_with = [n, m = planned.plan.num_controls](const TrackingCost& cost) {
    if (cost.Q.size() != 1) return std::string("Q: expected one matrix");
    for (const auto& [name, matrix, size] :
         {std::tuple("Q", &cost.Q[0], n), std::tuple("R", &cost.R, Eigen::Index{m}), std::tuple("QT", &cost.QT, n)}) {
      const std::string wrong = WhatIsWrongWithSymmetric(*matrix, size, /*definite=*/matrix == &cost.R);
      if (!wrong.empty()) return name + (": " + wrong);
    }
    return std::string();
  };
  planned.make_plant = [scene, contact] { return MakePlant(MakeSimulator(contact, scene, Precision::kDouble)); };
  return planned;
}

py::tuple Track(const PlannedMotion& planned, const Matrices& Q, const Eigen::MatrixXd& R, const Eigen::MatrixXd& QT) {
  if (planned.plan.num_controls == 0) throw py::value_error("the motion has no control, expected one with a control");
  const TrackingCost cost{.Q = Q, .R = R, .QT = QT};
  if (const std::string wrong = planned.what_is_wrong_with(cost); !wrong.empty()) throw py::value_error(wrong);
  Regulator regulator;
  Computation().RunOrThrow([&] { regulator = saltus::Track(planned.linear, cost); });
  return RegulatorToPython(regulator, planned.remark);
}

Noise CheckedNoise(const PlannedMotion& planned, const std::array<Eigen::MatrixXd, 4>& covariances,
                   const Matrices& gains) {
  Noise noise{covariances[0], covariances[1], covariances[2], covariances[3]};
  if (const std::string wrong = WhatIsWrongWith(noise, planned.linear); !wrong.empty()) throw py::value_error(wrong);
  if (gains.empty()) return noise;
  if (const std::string wrong = WhatIsWrongWith(Regulator{.gains = gains}, planned.linear); !wrong.empty()) {
    throw py::value_error(wrong);
  }
  return noise;
}

// Covariances at the nodes, standard deviations of the events' times, risks, the probability of them, the warning.
py::tuple Propagate(const PlannedMotion& planned, const std::array<Eigen::MatrixXd, 4>& covariances,
                    const Matrices& gains) {
  const Noise noise = CheckedNoise(planned, covariances, gains);
  Covariance found;
  const Regulator regulator{.gains = gains};
  Computation().RunOrThrow(
      [&] { found = saltus::Propagate(planned.linear, noise, gains.empty() ? nullptr : &regulator); });
  std::vector<std::tuple<std::string, double, double>> risks;
  for (const SequenceRisk& risk : found.risks) risks.emplace_back(risk.what, risk.time, risk.probability);
  const std::string warning = found.Warning();
  return py::make_tuple(found.nodes, found.event_times, risks, found.change_probability, warning, planned.remark);
}

// Mean and covariance of the final state, the planned final state, and how many runs count, fail and go otherwise.
py::tuple NoisyRuns(const PlannedMotion& planned, const std::array<Eigen::MatrixXd, 4>& covariances,
                    const Matrices& gains, int samples, std::uint64_t seed, int threads) {
  const Noise noise = CheckedNoise(planned, covariances, gains);
  if (samples < 1) throw py::value_error("samples: expected a number of at least 1");
  const int used = ReadThreads(threads);
  MonteCarlo runs;
  Computation().RunOrThrow([&] {
    runs = RunMonteCarlo(
        planned.plan, gains, noise, planned.make_plant, {.samples = samples, .seed = seed, .threads = used});
  });
  return py::make_tuple(
      runs.mean, runs.covariance, planned.plan.states.back(), runs.counted, runs.failed, runs.otherwise);
}

void Predict(SaltedKalmanFilter* filter, double time, const std::vector<double>& control,
             const Eigen::MatrixXd& process) {
  if (!(time >= filter->time())) throw py::value_error("time: expected one of at least the filter's time");
  bool ok = false;
  Computation().RunOrThrow([&] { ok = filter->Predict(time, control, process); });
  if (!ok) throw std::runtime_error(filter->WhyFailed());
}

void CheckEstimate(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance, Eigen::Index size) {
  if (mean.size() != size) throw py::value_error("mean: expected " + std::to_string(size) + " numbers");
  if (covariance.rows() != size || covariance.cols() != size) {
    throw py::value_error("covariance: expected " + std::to_string(size) + " x " + std::to_string(size) + " numbers");
  }
}

}  // namespace

py::tuple RegulatorToPython(const Regulator& regulator, const std::string& remark) {
  py::list events;
  for (const Regulator::AtEvent& at : regulator.events) {
    events.append(py::make_tuple(at.time, at.saltation, at.gain_before, at.gain_after, at.cost_before, at.cost_after));
  }
  return py::make_tuple(regulator.gains, regulator.cost_to_go, regulator.closed_loop, events, remark);
}

void BindFeedback(py::module_* module) {
  py::class_<PlannedMotion>(*module, "PlannedMotion")
      .def(py::init(&PlanScene), py::arg("scene"), py::arg("control"), py::arg("contact"))
      .def("track", &Track, py::arg("Q"), py::arg("R"), py::arg("QT"))
      .def("propagate", &Propagate, py::arg("covariances"), py::arg("gains"))
      .def("noisy_runs",
           &NoisyRuns,
           py::arg("covariances"),
           py::arg("gains"),
           py::arg("samples"),
           py::arg("seed"),
           py::arg("threads"));
  py::class_<SaltedKalmanFilter>(*module, "SaltedKalmanFilter")
      .def(py::init([](const Scene& scene, double time, const Eigen::VectorXd& mean, const Eigen::MatrixXd& P) {
             CheckTakes("event", scene);
             CheckEstimate(mean, P, InitialSize(scene));
             return SaltedKalmanFilter(scene, time, mean, P);
           }),
           py::arg("scene"),
           py::arg("time"),
           py::arg("mean"),
           py::arg("covariance"))
      .def(py::init([](const HybridSystem& system,
                       const std::vector<double>& parameters,
                       double time,
                       int mode,
                       const Eigen::VectorXd& mean,
                       const Eigen::MatrixXd& P) {
             CheckEstimate(mean, P, system.state_size(mode));
             return SaltedKalmanFilter(system, parameters, time, mode, mean, P);
           }),
           py::arg("system"),
           py::arg("parameters"),
           py::arg("time"),
           py::arg("mode"),
           py::arg("mean"),
           py::arg("covariance"))
      .def("predict", &Predict, py::arg("time"), py::arg("control"), py::arg("process"))
      .def(
          "update",
          [](SaltedKalmanFilter* filter,
             const Eigen::VectorXd& z,
             const Eigen::VectorXd& h,
             const Eigen::MatrixXd& C,
             const Eigen::MatrixXd& V) { return filter->Update(z, h, C, V); },
          py::arg("z"),
          py::arg("h"),
          py::arg("C"),
          py::arg("V"))
      .def_property_readonly("time", &SaltedKalmanFilter::time)
      .def_property_readonly("mode", &SaltedKalmanFilter::mode)
      .def_property_readonly("mean", &SaltedKalmanFilter::mean)
      .def_property_readonly("covariance", &SaltedKalmanFilter::covariance);
}

}  // namespace saltus::python
