#include <algorithm>
#include <cmath>

#include "convert.h"
#include "motion.h"
#include "programs/json_output.h"
#include "saltus/control/control_rows.h"
#include "saltus/simulate/events.h"
#include "scene/units.h"

namespace saltus::python {
namespace {

constexpr double kMebibyte = 1 << 20;

SingleShooting MakeShooting(const Contact& contact, const Scene& near, const std::string& precision) {
  CheckTakes(contact, near);
  SingleShooting::SimulatorFactory simulator_factory;
  const bool exact = FindContactModel(contact)->event_driven && ReadPrecision(precision) == Precision::kDouble;
  if (near.objective.duration && exact && near.optimize == Optimize::kControl) {
    simulator_factory = [contact](const Scene& other) { return MakeSimulator(contact, other, Precision::kDouble); };
  }
  return SingleShooting(
      MakeSimulator(contact, near, ReadPrecision(precision)), SingleShooting::Variables::kOptimized, simulator_factory);
}

}  // namespace

Shape VariablesShape(const SingleShooting& shooting) {
  const Scene& scene = shooting.scene();
  if (!scene.free_spin.empty()) return {shooting.num_variables()};
  if (scene.optimize == Optimize::kControl) {
    const Shape control{shooting.simulator().num_steps(), scene.num_controlled(), ControlColumns(scene)};
    return shooting.has_duration() ? Shape{SizeOf(control) + 1} : control;
  }
  return {shooting.num_variables() / 2, 2};
}

bool HasTorques(const Scene& scene) { return scene.optimize == Optimize::kControl && scene.num_torques() > 0; }

void ConvertPositions(std::span<double> numbers, size_t stride, const Units& from, const Units& to) {
  for (size_t i = 0; i + 1 < numbers.size(); i += stride) {
    const Vec2d position = ConvertPosition({numbers[i], numbers[i + 1]}, from, to);
    std::copy_n(position.data(), 2, numbers.data() + i);
  }
}

std::span<const double> NearVariables(const Scene& scene, const Scene& near, std::span<const double> z,
                                      std::vector<double>* moved, size_t points) {
  if (points == 0) return z;
  if (HasTorques(scene)) {
    moved->clear();
    const size_t size = z.size() / points, forces = size - scene.objective.duration.has_value();
    for (size_t i = 0; i < points; ++i) {
      const std::span<const double> point = z.subspan(i * size, size);
      const std::vector<double> control = ControlOfRows(scene, point.first(forces));
      moved->insert(moved->end(), control.begin(), control.end());
      moved->insert(moved->end(), point.begin() + static_cast<std::ptrdiff_t>(forces), point.end());
    }
    return *moved;
  }
  if (scene.optimize != Optimize::kPosition) return z;
  moved->assign(z.begin(), z.end());
  ConvertPositions(*moved, 2, scene.units, near.units);
  return *moved;
}

void PutGradient(const Scene& scene, std::span<const double> gradient, std::span<double> to) {
  const size_t behind = scene.objective.duration.has_value();
  const std::vector<double> rows = RowsOfGradient(scene, gradient.first(gradient.size() - behind));
  std::copy(rows.begin(), rows.end(), to.begin());
  if (behind > 0) to.back() = gradient.back();
}

Simulation::Simulation(const Scene& scene, const Contact& contact, const std::string& precision, double memory_limit)
    : scene_(scene),
      near_(NearOrigin(scene)),
      contact_(contact.name()),
      shooting_(MakeShooting(contact, near_, precision)) {
  if (!(memory_limit > 0 && memory_limit < 1e9)) {
    throw py::value_error("memory_limit: found " + std::to_string(memory_limit) + ", expected MiB > 0");
  }
  shooting_.set_stop(user_.stop());
  shooting_.set_memory_limit(static_cast<std::size_t>(memory_limit * kMebibyte));
}

Array Simulation::InitialGuess() const {
  if (HasTorques(scene_)) {
    const std::vector<double> known = shooting_.initial_guess();
    const size_t behind = shooting_.has_duration();
    std::vector<double> rows = RowsOfControl(scene_, std::span(known).first(known.size() - behind));
    rows.insert(rows.end(), known.end() - static_cast<std::ptrdiff_t>(behind), known.end());
    return ToArray(rows, shape());
  }
  Array guess = ToArray(shooting_.initial_guess(), shape());
  if (scene_.optimize != Optimize::kPosition) return guess;
  for (size_t i = 0; i < scene_.free.size(); ++i) {
    std::copy_n(scene_.bodies[scene_.free[i]].position.data(), 2, guess.mutable_data() + 2 * i);
  }
  return guess;
}

Array Simulation::Variables(const py::object& z) const {
  if (z.is_none()) return InitialGuess();
  const std::string name = scene_.optimize == Optimize::kNone ? "z" : OptimizeToString(scene_.optimize);
  const Array read = ReadArray(z, name, shape());
  if (HasTorques(scene_)) CheckRows(scene_, name, View(read).first(read.size() - shooting_.has_duration()));
  return read;
}

template <typename Evaluate>
void Simulation::Compute(const Evaluate& evaluate) {
  std::string failure;
  int unresolved = 0;  // read as the only user, too
  Computation computation;
  computation.RunOrThrow([&] {
    const OneUser::Use use(&user_, &computation);
    const bool ok = evaluate();
    unresolved = NumUnresolvedSteps(shooting_.simulator());
    const std::string why = shooting_.FailureReason();
    if (ok && why.empty()) return;
    failure = why.empty() ? contact_ + ": the loss is not finite"
                          : (ok ? "the gradient is not finite: " : "the rollout fails: ") + why;
  });
  if (!failure.empty()) throw std::runtime_error(failure);
  WarnOfUnresolved(unresolved, shooting_.simulator().num_steps());
}

template <typename Evaluate>
void Simulation::ComputeAt(const Array& variables, const Evaluate& evaluate) {
  Compute([&] {
    const std::span<const double> near = NearVariables(scene_, near_, View(variables), &moved_);
    unclear_.clear();
    if (!evaluate(near)) return false;
    if (MayHaveRemarks(shooting_.simulator())) unclear_.assign(near.begin(), near.end());
    return true;
  });
}

py::object Simulation::Remarks() {
  Json remarks = Json::array();
  Compute([&] {
    if (unclear_.empty()) return true;
    double loss = 0;  // steps may have been asked for since
    if (!shooting_.Evaluate(unclear_, &loss, nullptr)) return false;
    remarks = RemarksToJson(
        RemarksOn(shooting_.simulator(), shooting_.InitialStateAt(unclear_), shooting_.ControlAt(unclear_)));
    return true;
  });
  return ToPython(remarks);
}

double Simulation::Loss(const py::object& z) {
  const Array variables = Variables(z);
  double loss = 0;
  ComputeAt(variables, [&](std::span<const double> near) { return shooting_.Evaluate(near, &loss, nullptr); });
  return ConvertLoss(loss, near_.units, scene_.units);
}

py::tuple Simulation::LossAndGradient(const py::object& z, const py::object& out) {
  const Array variables = Variables(z);
  // In the shape of z, flat or not, unless told otherwise.
  Array gradient = out.is_none() ? Array(Shape(variables.shape(), variables.shape() + variables.ndim()))
                                 : WritableArray(out, "out", shape(), &variables);
  double loss = 0;
  std::vector<double> own(HasTorques(scene_) ? shooting_.num_variables() : 0);
  ComputeAt(variables, [&](std::span<const double> near) {
    return shooting_.Evaluate(near, &loss, own.empty() ? MutableView(gradient).data() : own.data());
  });
  if (!own.empty()) PutGradient(scene_, own, MutableView(gradient));
  return py::make_tuple(ConvertLoss(loss, near_.units, scene_.units), gradient);
}

py::tuple Simulation::Residuals(const py::object& z) {
  if (!scene_.objective.IsSumOfSquares()) {
    throw py::value_error("the objective is no sum of squares: a term has a component");
  }
  const Array variables = Variables(z);
  Array residuals(Shape{shooting_.num_residuals()}), jacobian(Shape{shooting_.num_residuals(), num_variables()});
  ComputeAt(variables, [&](std::span<const double> near) {
    if (!HasTorques(scene_)) {
      return shooting_.EvaluateResiduals(near, residuals.mutable_data(), jacobian.mutable_data());
    }
    const size_t rows = shooting_.num_residuals(), width = shooting_.num_variables(), columns = num_variables();
    std::vector<double> own(rows * width);
    if (!shooting_.EvaluateResiduals(near, residuals.mutable_data(), own.data())) return false;
    for (size_t row = 0; row < rows; ++row) {
      PutGradient(
          scene_, std::span(own).subspan(row * width, width), MutableView(jacobian).subspan(row * columns, columns));
    }
    return true;
  });
  return py::make_tuple(residuals, jacobian);
}

void Simulation::MoveFromNear(std::span<double> states) const {
  ConvertPositions(states, body_size(), near_.units, scene_.units);
}

py::dict Simulation::Rollout(const py::object& z, const py::object& out) {
  const Array variables = Variables(z);
  Array states = WritableArray(out, "out", {num_steps() + 1, scene_.num_bodies(), body_size()}, &variables);
  Array times(Shape{num_steps() + 1});
  double loss = 0;
  Json events, remarks;
  std::vector<int> touched;
  ComputeAt(variables, [&](std::span<const double> near) {
    if (!shooting_.Evaluate(near, &loss, nullptr)) return false;
    const Simulator& simulator = shooting_.simulator();  // of the final time in z, if that is free
    for (int k = 0; k <= simulator.num_steps(); ++k) times.mutable_data()[k] = k * simulator.step();
    const size_t size = simulator.state_size();
    for (int k = 0; k <= simulator.num_steps(); ++k) simulator.GetState(k, MutableView(states).subspan(k * size, size));
    MoveFromNear(MutableView(states));
    events = EventsToJson(EventsOf(simulator));
    const saltus::Remarks found = RemarksOn(simulator, shooting_.InitialStateAt(near), shooting_.ControlAt(near));
    remarks = RemarksToJson(found);
    for (const StepTouch& touch : simulator.touches()) {
      if (touched.empty() || touched.back() != touch.step) touched.push_back(touch.step);
    }
    return true;
  });
  py::dict result;
  result["loss"] = ConvertLoss(loss, near_.units, scene_.units);
  result["times"] = times;
  result["states"] = states;
  result["events"] = ToPython(events);
  result["remarks"] = ToPython(remarks);
  result["steps_with_contact"] = py::array_t<int>(static_cast<py::ssize_t>(touched.size()), touched.data());
  return result;
}

Array Simulation::NearState(const py::object& state) const {
  if (scene_.HasPaths()) {
    throw py::value_error("the scene has prescribed motions, and a step by itself has no time: use rollout");
  }
  const Array read = ReadArray(state, "state", {scene_.num_bodies(), body_size()});
  Array near = ToArray(View(read), {read.size()});
  ConvertPositions(MutableView(near), body_size(), scene_.units, near_.units);
  return near;
}

Array Simulation::Force(const py::object& force) const {
  const Simulator& simulator = shooting_.simulator();
  Array on_all(Shape{simulator.force_size()});
  std::vector<double> row = InitialControl(scene_, 1);
  if (!force.is_none()) {
    const Array read = ReadArray(force, "force", {scene_.num_controlled(), ControlColumns(scene_)});
    CheckRows(scene_, "force", View(read));
    row = ControlOfRows(scene_, View(read));
  }
  simulator.ExpandForce(row, 0, MutableView(on_all));
  return on_all;
}

Array Simulation::Step(const py::object& state, const py::object& force) {
  const Array x = NearState(state), u = Force(force);
  Array next(Shape{scene_.num_bodies(), body_size()});
  Compute([&] {
    shooting_.simulator().Step(View(x), View(u), MutableView(next));
    return true;
  });
  if (std::isnan(next.data()[0])) throw std::runtime_error(contact_ + ": the step fails from this state");
  MoveFromNear(MutableView(next));
  return next;
}

py::tuple Simulation::Linearize(const py::object& state, const py::object& force) {
  const Array x = NearState(state), u = Force(force);
  Eigen::MatrixXd A, B;
  Compute([&] {
    StepLinearization linearization;
    shooting_.simulator().Linearize(View(x), View(u), /*with_parameters=*/false, &linearization);
    linearization.ToDense(&A, &B);
    return true;
  });
  const py::ssize_t size = A.rows(), columns = scene_.num_controlled() * ControlColumns(scene_);
  Array by_state(Shape{size, size}), by_force(Shape{size, scene_.num_controlled(), ControlColumns(scene_)});
  std::vector<double> by_all(B.cols()), by_control(scene_.control_width());
  for (py::ssize_t row = 0; row < size; ++row) {
    for (py::ssize_t column = 0; column < size; ++column) by_state.mutable_at(row, column) = A(row, column);
    Eigen::Map<Eigen::RowVectorXd>(by_all.data(), B.cols()) = B.row(row);
    shooting_.simulator().SelectControl(by_all, by_control);
    const std::vector<double> rows = RowsOfGradient(scene_, by_control);
    std::copy(rows.begin(), rows.end(), by_force.mutable_data() + row * columns);
  }
  return py::make_tuple(by_state, by_force);
}

void BindSimulation(py::module_* module) {
  py::class_<Simulation>(*module, "Simulation")
      .def(py::init([](const Scene& scene, const py::object& contact, const std::string& precision, double limit) {
             return std::make_unique<Simulation>(scene, ReadContact(contact), precision, limit);
           }),
           py::arg("scene"),
           py::arg("contact") = "event",
           py::kw_only(),
           py::arg("precision") = "double",
           py::arg("memory_limit") = 1024.0)
      .def_property_readonly("scene", &Simulation::scene, py::return_value_policy::copy)
      .def_property_readonly("contact", &Simulation::contact)
      .def_property_readonly("shape",
                             [](const Simulation& simulation) { return py::tuple(py::cast(simulation.shape())); })
      .def_property_readonly("num_variables", &Simulation::num_variables)
      .def_property_readonly("num_steps", &Simulation::num_steps)
      .def_property_readonly("initial_guess", &Simulation::InitialGuess)
      .def_property_readonly("remarks", &Simulation::Remarks)
      .def("loss", &Simulation::Loss, py::arg("z") = py::none())
      .def("loss_and_gradient", &Simulation::LossAndGradient, py::arg("z") = py::none(), py::arg("out") = py::none())
      .def("residuals", &Simulation::Residuals, py::arg("z") = py::none())
      .def("rollout", &Simulation::Rollout, py::arg("z") = py::none(), py::arg("out") = py::none())
      .def("step", &Simulation::Step, py::arg("state"), py::arg("force") = py::none())
      .def("linearize", &Simulation::Linearize, py::arg("state"), py::arg("force") = py::none());
}

}  // namespace saltus::python
