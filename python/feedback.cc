#include "feedback.h"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
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

// Lengths of `intervals` control intervals, whose sum is the scene's duration unless that is free. None: equal ones.
std::vector<double> ReadDurations(const Scene& scene, const py::object& durations, py::ssize_t intervals) {
  if (durations.is_none()) return {};
  std::vector<double> lengths = ToVector(ReadArray(durations, "durations", {intervals}));
  const double sum = std::accumulate(lengths.begin(), lengths.end(), 0.0);
  if (!std::ranges::all_of(lengths, [](double length) { return length >= 0; }) || !(sum > 0)) {
    throw py::value_error("durations: expected numbers >= 0, one of them not 0");
  }
  if (!scene.objective.duration && std::abs(sum - scene.duration) > 1e-9 * scene.duration) {
    throw py::value_error("durations: found a sum of " + std::to_string(sum) + " s, expected the scene's duration, " +
                          std::to_string(scene.duration) + " s");
  }
  return lengths;
}

// The exact motion of a scene under a control on intervals that last `durations`, or under its own; runs are simulated
// under `contact`, of which one step covers an interval.
PlannedMotion PlanMotion(Scene scene, const py::object& control, const py::object& durations,
                         const py::object& contact_name) {
  const Contact contact = ReadContact(contact_name);
  std::vector<double> numbers = InitialControl(scene, scene.steps), lengths;
  if (control.is_none()) {
    if (!durations.is_none()) throw py::value_error("durations: found some without a plan");
  } else {
    if (durations.is_none() && scene.objective.duration) {
      throw py::value_error(
          "plan: found a control alone, whose duration is not known, as that of the scene is free; pass the run, or "
          "durations");
    }
    const py::ssize_t intervals = durations.is_none() ? scene.steps : static_cast<py::ssize_t>(py::len(durations));
    lengths = ReadDurations(scene, durations, intervals);
    if (scene.control_width() > 0) {
      const Array rows = ReadArray(control, "plan", {intervals, scene.num_controlled(), ControlColumns(scene)});
      CheckRows(scene, "plan", View(rows));
      numbers = ControlOfRows(scene, View(rows));
      scene.steps = static_cast<int>(intervals);
    }
    if (!lengths.empty()) scene.duration = std::accumulate(lengths.begin(), lengths.end(), 0.0);
  }
  CheckTakes("event", scene);
  ScenePlan found;
  Computation().RunOrThrow([&] {
    found = PlanScene(scene, InitialState(scene), numbers, lengths);
    if (!found.reason.empty()) throw std::runtime_error(found.reason);
  });
  scene.steps *= FindContactModel(contact)->grid_steps;
  CheckTakes(contact, scene);
  PlannedMotion planned;
  planned.plan = std::move(found.plan);
  planned.linear = std::move(found.linear);
  planned.remark = found.remark;
  const Eigen::Index n = planned.plan.states.front().size();
  planned.what_is_wrong_with = [n, m = planned.plan.num_controls](const TrackingCost& cost) {
    if (cost.Q.size() != 1) return std::string("Q: expected one matrix");
    for (const auto& [name, matrix, size] :
         {std::tuple("Q", &cost.Q[0], n), std::tuple("R", &cost.R, Eigen::Index{m}), std::tuple("QT", &cost.QT, n)}) {
      const std::string wrong = ValidateSymmetric(*matrix, size, /*definite=*/matrix == &cost.R);
      if (!wrong.empty()) return name + (": " + wrong);
    }
    return std::string();
  };
  planned.make_plant = [scene, contact, lengths = found.lengths] { return MakePlant(contact, scene, lengths); };
  return planned;
}

py::tuple Track(const PlannedMotion& planned, const Matrices& Q, const Eigen::MatrixXd& R, const Eigen::MatrixXd& QT) {
  if (planned.plan.num_controls == 0) throw py::value_error("the motion has no control, expected one with a control");
  const TrackingCost cost{.Q = Q, .R = R, .QT = QT};
  if (const std::string wrong = planned.what_is_wrong_with(cost); !wrong.empty()) throw py::value_error(wrong);
  Regulator regulator;
  Computation().RunOrThrow([&] { regulator = saltus::Track(planned.linear, cost); });
  if (regulator.gains.empty()) throw py::value_error(kNoRegulator);
  return RegulatorToPython(regulator, planned.remark);
}

Noise CheckedNoise(const PlannedMotion& planned, const std::array<Eigen::MatrixXd, 4>& covariances,
                   const Matrices& gains) {
  Noise noise{covariances[0], covariances[1], covariances[2], covariances[3]};
  if (const std::string wrong = Validate(noise, planned.linear); !wrong.empty()) throw py::value_error(wrong);
  if (gains.empty()) return noise;
  if (const std::string wrong = Validate(Regulator{.gains = gains}, planned.linear); !wrong.empty()) {
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
  for (const SequenceRisk& risk : found.risks) risks.emplace_back(risk.description, risk.time, risk.probability);
  const std::string warning = found.Warning();
  return py::make_tuple(found.nodes, found.event_times, risks, found.change_probability, warning, planned.remark);
}

// Mean and covariance of the final state, the planned final state, and how many runs count, fail and go otherwise,
// remarks.
py::tuple NoisyRuns(const PlannedMotion& planned, const std::array<Eigen::MatrixXd, 4>& covariances,
                    const Matrices& gains, int samples, std::uint64_t seed, int threads, double seconds) {
  const Noise noise = CheckedNoise(planned, covariances, gains);
  if (samples < 1) throw py::value_error("samples: expected a number of at least 1");
  const int used = ReadThreads(threads);
  MonteCarlo runs;
  Computation computation(seconds);
  computation.RunOrThrow([&] {
    runs = RunMonteCarlo(planned.plan,
                         gains,
                         noise,
                         planned.make_plant,
                         {.samples = samples, .seed = seed, .threads = used, .stop = computation.stop()});
  });
  std::vector<std::string> remarks;
  if (!planned.remark.empty()) remarks.push_back(planned.remark);
  if (runs.simulated < samples) {
    remarks.push_back(std::to_string(runs.simulated) + " of " + std::to_string(samples) +
                      " runs were simulated: " + computation.ReasonTimedOut());
  }
  if (runs.counted < 2) {
    remarks.push_back("there is no covariance: found " + std::to_string(runs.counted) +
                      " runs that count, expected at least 2; raise samples");
  }
  return py::make_tuple(
      runs.mean, runs.covariance, planned.plan.states.back(), runs.counted, runs.failed, runs.off_plan, remarks);
}

Eigen::VectorXd ReadVector(const py::handle& value, const std::string& name, Eigen::Index size) {
  const Array array = ReadArray(value, name, {size});
  return Eigen::Map<const Eigen::VectorXd>(array.data(), size);
}

Eigen::MatrixXd ReadMatrix(const py::handle& value, const std::string& name, Eigen::Index rows, Eigen::Index columns) {
  const Array array = ReadArray(value, name, {rows, columns});
  return Eigen::Map<const RowMajor>(array.data(), rows, columns);
}

void CheckCovariance(const Eigen::MatrixXd& matrix, const std::string& name) {
  const std::string wrong = ValidateSymmetric(matrix, matrix.rows(), /*definite=*/false);
  if (!wrong.empty()) throw py::value_error(name + ": " + wrong);
}

// A filter, and what arguments of its methods are compared with.
class Filter {
 public:
  Filter(const Scene& scene, double time, const py::object& mean, const py::object& covariance)
      : num_controls_(scene.control_width()), state_sizes_{static_cast<int>(InitialSize(scene))} {
    CheckTakes("event", scene);
    const int n = state_sizes_[0];
    const Eigen::VectorXd estimate = ReadVector(mean, "mean", n);  // the mean is named first where both are wrong
    filter_.emplace(scene, ReadTime(time), estimate, ReadCovariance(covariance, "covariance", n), user_.stop());
  }
  Filter(const HybridSystem& system, const py::object& parameters, double time, int mode, const py::object& mean,
         const py::object& covariance)
      : num_controls_(system.num_controls()), system_(system) {
    for (int i = 0; i < system.num_modes(); ++i) state_sizes_.push_back(system.state_size(i));
    const int n = system.state_size(mode);
    const Eigen::VectorXd estimate = ReadVector(mean, "mean", n);
    filter_.emplace(system,
                    ToVector(ReadArray(parameters, "parameters", {system.num_parameters()})),
                    ReadTime(time),
                    mode,
                    estimate,
                    ReadCovariance(covariance, "covariance", n),
                    HybridOptions{.stop = user_.stop()});
  }
  // Mode -1: that in which a motion from the mean starts without a control.
  Filter(const MechanicalSystem& system, const py::object& parameters, double time, int mode, const py::object& mean,
         const py::object& covariance)
      : Filter(system.hybrid(), parameters, time, StartOf(system, parameters, ReadTime(time), mode, mean), mean,
               covariance) {}

  double time() {
    return Read<double>([this] { return filter_->time(); });
  }
  // The name of the mode; empty in a scene.
  std::string mode() {
    if (!system_) return "";
    return Read<std::string>([this] { return system_->ModeName(filter_->mode()); });
  }
  // Copies, because the filter gives up its own when it moves on.
  Eigen::VectorXd mean() {
    return Read<Eigen::VectorXd>([this] { return filter_->mean(); });
  }
  Eigen::MatrixXd covariance() {
    return Read<Eigen::MatrixXd>([this] { return filter_->covariance(); });
  }

  // The size of `process` is that of the state at the end: here it has to be that of some mode.
  void Predict(double time, const py::object& control, const py::object& process) {
    ReadTime(time);
    std::vector<double> numbers;
    if (!control.is_none()) numbers = ToVector(ReadArray(control, "control", {num_controls_}));
    Eigen::MatrixXd added;
    if (!process.is_none()) {
      const py::array given = py::array::ensure(process);
      const auto size = std::ranges::find(state_sizes_, given && given.ndim() == 2 ? given.shape(0) : -1);
      added = ReadCovariance(process, "process", size == state_sizes_.end() ? state_sizes_[0] : *size);
    }
    Compute([&] {
      if (!(time >= filter_->time())) {
        throw std::invalid_argument("time: found " + std::to_string(time) + ", expected at least the filter's time, " +
                                    std::to_string(filter_->time()));
      }
      if (!filter_->Predict(time, numbers, added)) throw std::runtime_error(filter_->FailureReason());
    });
  }

  double Update(const py::object& z, const py::object& h, const py::object& C, const py::object& V) {
    const py::array measured = py::array::ensure(z);
    if (!measured) throw py::type_error("z: expected an array of real numbers");
    const Eigen::Index r = measured.size();
    const Eigen::MatrixXd jacobian = ReadMatrix(C, "C", r, mean().size()), covariance = ReadMatrix(V, "V", r, r);
    CheckCovariance(covariance, "V");
    const Eigen::VectorXd numbers = ReadVector(z, "z", r);
    Eigen::VectorXd expected;
    if (!h.is_none()) expected = ReadVector(h, "h", r);
    return Read<double>([&] {
      const std::optional<double> likelihood = h.is_none() ? filter_->Update(numbers, jacobian, covariance)
                                                           : filter_->Update(numbers, expected, jacobian, covariance);
      if (!likelihood) throw std::invalid_argument(filter_->FailureReason());
      return *likelihood;
    });
  }

 private:
  // Without the GIL, as the only user.
  template <typename Function>
  void Compute(const Function& function) {
    Computation computation;
    computation.RunOrThrow([&] {
      const OneUser::Use use(&user_, &computation);
      function();
    });
  }
  template <typename Value, typename Function>
  Value Read(const Function& function) {
    Value value;
    Compute([&] { value = function(); });
    return value;
  }

  static double ReadTime(double time) {
    if (!std::isfinite(time)) throw py::value_error("time: found " + std::to_string(time) + ", expected a finite time");
    return time;
  }
  static int StartOf(const MechanicalSystem& system, const py::object& parameters, double time, int mode,
                     const py::object& mean) {
    const HybridSystem& hybrid = system.hybrid();
    HybridInput input{.mode = mode, .begin = time};
    input.initial = ToVector(ReadArray(mean, "mean", {hybrid.state_size(0)}));
    input.parameters = ToVector(ReadArray(parameters, "parameters", {hybrid.num_parameters()}));
    if (const std::string why = ReasonNoStart(system, &input); !why.empty()) throw py::value_error("mean: " + why);
    return input.mode;
  }
  static Eigen::MatrixXd ReadCovariance(const py::object& value, const std::string& name, int n) {
    Eigen::MatrixXd covariance = ReadMatrix(value, name, n, n);
    CheckCovariance(covariance, name);
    return covariance;
  }

  int num_controls_;              // numbers of a control
  std::vector<int> state_sizes_;  // of the modes
  std::optional<HybridSystem> system_;
  std::optional<SaltedKalmanFilter> filter_;
  OneUser user_;
};

}  // namespace

py::tuple RegulatorToPython(const Regulator& regulator, const std::string& remark) {
  py::list events;
  for (const Regulator::EventJump& at : regulator.events) {
    events.append(py::make_tuple(at.time, at.saltation, at.gain_before, at.gain_after, at.cost_before, at.cost_after));
  }
  return py::make_tuple(regulator.gains, regulator.cost_to_go, regulator.closed_loop, events, remark);
}

void BindFeedback(py::module_* module) {
  py::class_<PlannedMotion>(*module, "PlannedMotion")
      .def(py::init(&PlanMotion), py::arg("scene"), py::arg("control"), py::arg("durations"), py::arg("contact"))
      .def("track", &Track, py::arg("Q"), py::arg("R"), py::arg("QT"))
      .def("propagate", &Propagate, py::arg("covariances"), py::arg("gains"))
      .def("noisy_runs",
           &NoisyRuns,
           py::arg("covariances"),
           py::arg("gains"),
           py::arg("samples"),
           py::arg("seed"),
           py::arg("threads"),
           py::arg("seconds"));
  py::class_<Filter> filter(*module, "SaltedKalmanFilter");
  const auto define_with = [&]<typename System>(const System*) {
    filter.def(py::init<const System&, const py::object&, double, int, const py::object&, const py::object&>(),
               py::arg("system"),
               py::arg("parameters"),
               py::arg("time"),
               py::arg("mode"),
               py::arg("mean"),
               py::arg("covariance"));
  };
  define_with(static_cast<const HybridSystem*>(nullptr));
  define_with(static_cast<const MechanicalSystem*>(nullptr));
  filter
      .def(py::init<const Scene&, double, const py::object&, const py::object&>(),
           py::arg("scene"),
           py::arg("time"),
           py::arg("mean"),
           py::arg("covariance"))
      .def("predict", &Filter::Predict, py::arg("time"), py::arg("control"), py::arg("process"))
      .def("update", &Filter::Update, py::arg("z"), py::arg("h"), py::arg("C"), py::arg("V"))
      .def_property_readonly("time", &Filter::time)
      .def_property_readonly("mode", &Filter::mode)
      .def_property_readonly("mean", &Filter::mean)
      .def_property_readonly("covariance", &Filter::covariance);
}

}  // namespace saltus::python
