// Simulators and contact models written in Python, as black boxes: they answer questions by being called.
#include "callable_box.h"

#include <pybind11/stl.h>

#include <memory>

#include "arrays.h"
#include "computation.h"
#include "convert.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_file.h"

namespace saltus::python {
namespace {

constexpr double kNotOfLoss = 1e-9;  // of a cotangent's square, what is not along the loss's
constexpr const char* kKinds[] = {"simulate", "gradient", "step"};

// The Python object for `scene`, with all that the package adds to it.
py::object SceneToPython(const Scene& scene) {
  const py::object type = py::module_::import("saltus._scene").attr("Scene");
  return type.attr("_of_text")(WriteScene(scene), scene.name);
}

class CallableBox final : public BlackBox {
 public:
  CallableBox(std::string name, py::object answerer, CallableOffer offer)
      : name_(std::move(name)), answerer_(std::move(answerer)), offer_(std::move(offer)) {}
  ~CallableBox() override {
    const py::gil_scoped_acquire acquire;
    answerer_ = py::object();
    scene_of_ = py::object();
  }

  const std::string& name() const override { return name_; }
  BlackBoxTraits Describe(const Scene& scene) override {
    BlackBoxTraits traits;
    traits.name = name_;
    traits.gradient = offer_.gradient && (!offer_.loss || scene.objective == *offer_.loss);
    traits.step = offer_.step;
    traits.states = offer_.states;
    return traits;
  }

  std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& requests,
                                       const StopRequest& stop) override {
    std::vector<BlackBoxAnswer> answers(requests.size());
    const py::gil_scoped_acquire acquire;
    for (size_t i = 0; i < requests.size(); ++i) {
      if (stop && stop()) {
        answers[i].error = kStopped;
        continue;
      }
      try {
        answers[i] = ComputeAnswer(scene, requests[i]);
      } catch (const std::exception& error) {
        answers[i].error = error.what();
        Computation::StopCurrent(std::current_exception());
      }
    }
    return answers;
  }

 private:
  BlackBoxAnswer ComputeAnswer(const Scene& scene, const BlackBoxRequest& request) {
    const bool step = request.kind == BlackBoxRequest::Kind::kStep,
               gradient = request.kind == BlackBoxRequest::Kind::kGradient;
    const Shape states = {scene.num_bodies(), 4};
    const Shape control = step ? Shape{scene.num_bodies(), 2} : Shape{request.steps, scene.num_controlled(), 2};
    const py::object final_cotangent = gradient ? py::object(ToArray(request.final_cotangent, states)) : py::none();
    const py::object given = answerer_(kKinds[static_cast<int>(request.kind)],
                                       SceneOf(scene),
                                       request.duration / request.steps,
                                       ToArray(request.initial, states),
                                       ToArray(request.control, control),
                                       final_cotangent);
    const py::dict parts = given.cast<py::dict>();
    const auto read = [&](const char* key, const Shape& shape) {
      return parts.contains(key) ? ToVector(ReadArray(parts[key], name_ + ": " + key, shape)) : std::vector<double>();
    };
    BlackBoxAnswer answer;
    answer.final = read("final state", states);
    answer.states = read("states", {request.steps + 1, scene.num_bodies(), 4});
    answer.initial = read("gradient by the initial state", states);
    answer.control = read("gradient by the control", control);
    if (gradient && offer_.loss) PullBackOfLoss(scene, request, &answer);
    return answer;
  }

  // From the gradient of the scene's loss to that of of_final . (final state). All questions are about multiples of the
  // loss, which may be in other units.
  void PullBackOfLoss(const Scene& scene, const BlackBoxRequest& request, BlackBoxAnswer* answer) const {
    std::vector<double> by_final(answer->final.size());
    TerminalGradient(scene.objective, answer->final, 4, by_final);
    double product = 0, square = 0, asked = 0;
    for (size_t i = 0; i < by_final.size(); ++i) {
      product += by_final[i] * request.final_cotangent[i];
      square += by_final[i] * by_final[i];
      asked += request.final_cotangent[i] * request.final_cotangent[i];
    }
    const double factor = square > 0 ? product / square : 0.0;
    if (asked - factor * product > kNotOfLoss * asked) {
      throw std::logic_error(name_ + ": asked for another gradient than that of the loss");
    }
    std::vector<double> effort(answer->control.size());
    AddEffortGradient(scene.objective, request.control, request.duration / request.steps, effort);
    for (size_t i = 0; i < effort.size(); ++i) answer->control[i] = factor * (answer->control[i] - effort[i]);
    for (double& entry : answer->initial) entry *= factor;
  }

  // Kept, as questions about one scene come in rows.
  py::object SceneOf(const Scene& scene) {
    if (!last_scene_ || !(*last_scene_ == scene)) {
      py::object made = SceneToPython(scene);  // another thread may run meanwhile
      scene_of_ = std::move(made);
      last_scene_ = scene;
    }
    return scene_of_;
  }

  std::string name_;
  py::object answerer_;
  CallableOffer offer_;
  std::optional<Scene> last_scene_;
  py::object scene_of_;
};

}  // namespace

std::shared_ptr<BlackBox> MakeCallableBox(const std::string& name, const py::object& answerer,
                                          const CallableOffer& offer) {
  if (name.empty() || name.find_first_of(":, ") != std::string::npos) {
    throw py::value_error("name: found '" + name + "', expected text without colons, commas and blanks");
  }
  return std::make_shared<CallableBox>(name, answerer, offer);
}

void BindContact(py::module_* module) {
  py::class_<Contact>(*module, "Contact")
      .def(py::init([](const std::string& name, const py::object& answerer) {
             const auto box = MakeCallableBox(name, answerer, {.gradient = true, .step = true, .states = true});
             return MakeBlackBoxContact(box, box->Describe({}), {.touches = true});
           }),
           py::arg("name"),
           py::arg("answerer"))
      .def_property_readonly("name", &Contact::name);
}

}  // namespace saltus::python
