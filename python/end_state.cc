// The final state of a motion as a function of its initial state and control, and its derivative from the left (vjp):
// what automatic differentiation of others is built of.

#include "arrays.h"
#include "computation.h"
#include "convert.h"
#include "motion.h"
#include "programs/json_output.h"
#include "saltus/control/control_rows.h"
#include "saltus/simulate/events.h"
#include "scene/scene_rules.h"
#include "scene/units.h"

namespace saltus::python {
namespace {

class EndState {
 public:
  EndState(const Scene& scene, const Contact& contact, const std::string& precision)
      : scene_(scene), near_(NearOrigin(scene)), contact_(contact.name()) {
    CheckTakes(contact, near_);
    simulator_ = MakeSimulator(contact, near_, ReadPrecision(precision));
    simulator_->set_stop(user_.stop());
  }

  // Shapes of scenes with discs that spin, as all states here: angle and angular velocity of a disc behind its
  // velocity.
  Shape InitialShape() const { return {scene_.num_bodies(), InitialSize(scene_) / scene_.num_bodies()}; }
  Shape ControlShape() const { return {simulator_->num_steps(), scene_.num_controlled(), ControlColumns(scene_)}; }
  Shape FinalShape() const { return {scene_.num_bodies(), simulator_->body_size()}; }
  Array Initial() const { return ToArray(ToState(InitialState(scene_), scene_.num_bodies()), InitialShape()); }
  Array Control() const {
    return ToArray(RowsOfControl(scene_, InitialControl(scene_, simulator_->num_steps())), ControlShape());
  }

  Array Evaluate(const py::object& initial, const py::object& control) {
    const Motion motion = Read(initial, control);
    Array final(FinalShape());
    Compute(motion, [&] { Read(MutableView(final)); });
    return final;
  }

  // The remarks on the motion of the last call; none before there is one.
  py::object Remarks() {
    Json remarks = Json::array();
    Computation computation;
    computation.RunOrThrow([&] {
      const OneUser::Use use(&user_, &computation);
      if (last_) remarks = RemarksToJson(RemarksOn(*simulator_, last_->initial, last_->control));
    });
    return ToPython(remarks);
  }

  // The gradients of cotangent . (final state) by the initial state and by the control.
  py::tuple PullBack(const py::object& initial, const py::object& control, const py::object& cotangent) {
    const Motion motion = Read(initial, control);
    const Array by_final = ReadArray(cotangent, "cotangent", FinalShape());
    std::vector<double> by_initial(InitialSize(scene_));
    std::vector<double> by_control(simulator_->control_size());
    Compute(motion, [&] {
      SensitivityView out;
      out.initial = by_initial;
      out.control = by_control;
      simulator_->AdjointInto(View(by_final), out);
    });
    return py::make_tuple(ToArray(ToState(by_initial, scene_.num_bodies()), InitialShape()),
                          ToArray(RowsOfGradient(scene_, by_control), ControlShape()));
  }

 private:
  struct Motion {
    std::vector<double> initial, control;
    bool operator==(const Motion&) const = default;
  };

  Motion Read(const py::object& initial, const py::object& control) const {
    const Array rows = ReadArray(control, "control", ControlShape());
    CheckRows(scene_, "control", View(rows));
    Motion motion{ToInitial(View(ReadArray(initial, "initial", InitialShape())), scene_.num_bodies()),
                  ControlOfRows(scene_, View(rows))};
    motion.initial = ConvertInitial(std::move(motion.initial), scene_.num_bodies(), scene_.units, near_.units);
    return motion;
  }

  std::string Failure() const {
    const std::string why = simulator_->FailureReason();
    return why.empty() ? "a state is not finite" : why;  // or it was stopped, which is said elsewhere
  }

  // Why there is no motion, or nothing. One that was simulated last is not simulated again.
  std::string Simulate(const Motion& motion) {
    if (last_ == motion) return "";
    last_.reset();
    if (const std::optional<SceneError> error = FindOverlapAt(near_, motion.initial)) return error->ToString();
    if (!simulator_->Rollout(motion.initial, motion.control)) return Failure();
    last_ = motion;
    return "";
  }

  void Read(std::span<double> final) const {
    simulator_->GetState(simulator_->num_steps(), final);
    ConvertPositions(final, simulator_->body_size(), near_.units, scene_.units);
  }

  // Simulates, and computes what is wanted of the motion, as the only user of the simulator. Throws without a motion.
  template <typename Function>
  void Compute(const Motion& motion, const Function& function) {
    std::string failure;
    int unresolved = 0;
    Computation computation;
    computation.Run([&] {
      const OneUser::Use use(&user_, &computation);
      failure = Simulate(motion);
      if (failure.empty()) function();
      unresolved = NumUnresolvedSteps(*simulator_);
    });
    computation.Rethrow();
    if (!failure.empty()) throw std::runtime_error("the rollout fails: " + failure);
    WarnOfUnresolved(unresolved, simulator_->num_steps());
  }

  Scene scene_, near_;
  std::string contact_;
  std::unique_ptr<Simulator> simulator_;
  std::optional<Motion> last_;
  OneUser user_;
};

}  // namespace

void BindEndState(py::module_* module) {
  py::class_<EndState>(*module, "EndState")
      .def(py::init([](const Scene& scene, const py::object& contact, const std::string& precision) {
             return std::make_unique<EndState>(scene, ReadContact(contact), precision);
           }),
           py::arg("scene"),
           py::arg("contact") = "event",
           py::kw_only(),
           py::arg("precision") = "double")
      .def_property_readonly("initial", &EndState::Initial)
      .def_property_readonly("control", &EndState::Control)
      .def_property_readonly("remarks", &EndState::Remarks)
      .def("__call__", &EndState::Evaluate, py::arg("initial"), py::arg("control"))
      .def("vjp", &EndState::PullBack, py::arg("initial"), py::arg("control"), py::arg("cotangent"));
}

}  // namespace saltus::python
