// The exact model of scenes with drag, springs or prescribed motions: their hybrid system (SceneSystemOf) is
// integrated, and its impacts are located on the arcs.
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "control/scene_constraints.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "scene/path_motion.h"
#include "simulate/forced_simulator.h"
#include "simulate/impact.h"
#include "simulate/parameter_derivative.h"

namespace saltus {
namespace {

// The scene with what moves its discs alone.
Scene RemoveObjective(Scene scene) {
  scene.objective = {};
  scene.no_contact.clear();
  scene.design.clear();
  return scene;
}

// The scene whose control is a force on every disc that moves and, if a disc is turned, a torque on every one that
// spins.
Scene ForceAllDiscs(Scene scene) {
  const bool has_torques = scene.num_torques() > 0;
  scene.control = {};
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].fixed) continue;
    scene.control.bodies.push_back(i);
    if (has_torques && scene.bodies[i].Spins()) scene.control.torque_bodies.push_back(i);
  }
  scene.control.initial.assign(scene.control.bodies.size(), Vec2d::Zero());
  scene.control.initial_torque.assign(scene.control.torque_bodies.size(), 0.0);
  return scene;
}

class IntegratedScene final : public Simulator {
 public:
  IntegratedScene(const Scene& scene, const ModelTraits& traits)
      : Simulator(scene, Precision::kDouble, /*grid_steps=*/1),
        traits_(traits),
        pushed_(ForceAllDiscs(RemoveObjective(scene))),
        pairs_(AllPairs(scene)),
        places_(scene, SceneParameters::kAll),
        motion_(SceneSystemOf(RemoveObjective(scene), SceneParameters::kNone), {.stop = [this] { return stopped(); }}) {
  }

  const ModelTraits& traits() const override { return traits_; }
  int body_size() const override { return initial_size() / num_bodies(); }
  std::size_t LeastMemory() const override { return (num_steps_ + std::size_t{1}) * state_size() * sizeof(double); }
  const std::vector<StepTouch>& touches() const override { return touches_; }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override {
    input_ = {.initial = Started(initial),
              .duration = scene_.duration,
              .num_intervals = num_steps_,
              .control = {control.begin(), control.end()}};
    touches_.clear();
    ties_.clear();
    failure_.reset();
    const bool ok = motion_.RolloutAccurately(input_);
    touches_ = TouchesOf(motion_, num_steps_);
    int number = 0;
    for (const HybridTie& tie : motion_.ties()) {
      if (!tie.ambiguous) continue;
      for (const int guard : tie.guards) {
        if (!IsPair(guard)) continue;
        const StepTouch at = TouchAt(pairs_[guard], tie.time, num_steps_);
        ties_.push_back({at.step, {at.touch.candidate, at.touch.time, number}});
      }
      ++number;
    }
    if (ok || stopped()) return ok;
    why_ = motion_.FailureReason();
    failure_ = {-1, -1, why_};
    if (const std::optional<double> time = motion_.accumulation()) {
      why_ = "impacts accumulate (Zeno behaviour), and discs do not come to rest on each other in scenes with " +
             NonBallisticForces(scene_) +
             ": end the motion before, or use a time-stepping model with short steps, such as ncp";
      const int step = std::min(static_cast<int>(*time / this->step()), num_steps_ - 1);
      failure_ = {step, touches_.empty() ? -1 : touches_.back().touch.candidate.a, why_};
    }
    return false;
  }

  void GetState(int k, std::span<double> x) const override {
    std::ranges::copy(ToState(motion_.StateAt(k), num_bodies()), x.begin());
  }

  void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) override {
    const HybridGradient gradient = motion_.Adjoint(ToInitial(cotangent, num_bodies()));
    for (std::size_t i = 0; i < out.initial.size(); ++i) {
      out.initial[i] = IsFree(static_cast<int>(i)) ? gradient.initial[i] : 0.0;
    }
    for (std::size_t i = 0; i < out.control.size(); ++i) {
      out.control[i] = gradient.control[i] + (out.factor == 0 ? 0.0 : out.factor * out.addend[i]);
    }
    if (out.parameters != nullptr) SetParameters(cotangent, out.parameters);
  }

  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override {
    HybridSimulator motion(SceneSystemOf(pushed_, SceneParameters::kNone));
    std::ranges::fill(next, NAN);
    if (!motion.Rollout(OneStep(x, force))) return;
    std::ranges::copy(ToState(motion.final_state(), num_bodies()), next.begin());
    for (const StepTouch& at : TouchesOf(motion, 1)) {
      if (touches != nullptr) touches->push_back(at.touch);
    }
  }

  // All discs are in one island, as springs connect discs that do not touch.
  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override {
    StepLinearization& out = *linearization = {};
    out.body_size = body_size();
    out.has_torques = scene_.num_torques() > 0;
    for (const Body& body : scene_.bodies) out.inverse_mass.push_back(InverseMass(body));
    StepLinearization::Island all;
    for (int i = 0; i < num_bodies(); ++i) all.bodies.push_back(i);
    all.A.setConstant(state_size(), state_size(), NAN);
    all.B.setConstant(state_size(), force_size(), NAN);
    HybridSimulator motion(SceneSystemOf(pushed_, with_parameters ? SceneParameters::kAll : SceneParameters::kNone));
    HybridInput input = OneStep(x, force);
    if (with_parameters) input.parameters.assign(places_.size(), 0.0);
    if (motion.Rollout(input)) {
      const HybridSensitivity by = motion.Sensitivity();
      const std::vector<int> place = PlacesInState();
      all.B.setZero();
      const int kinds = scene_.Spins() ? 3 : 2;  // of numbers of each disc
      if (with_parameters) all.P.resize(state_size(), 4 + kinds * num_bodies() + 2 * places_.num_pairs - 2);
      for (int row = 0; row < state_size(); ++row) {
        const double* of = &by.final_state[static_cast<std::size_t>(row) * by.columns];
        for (int column = 0; column < state_size(); ++column) all.A(place[row], place[column]) = of[column];
        const double* u = of + state_size();
        for (const int body : pushed_.control.bodies) {
          for (int j = 0; j < 2; ++j) all.B(place[row], 2 * body + j) = *u++;
        }
        for (const int body : pushed_.control.torque_bodies) all.B(place[row], 2 * num_bodies() + body) = *u++;
        if (with_parameters) all.P.row(place[row]) = ColumnsOf(u);
      }
    }
    out.islands.push_back(std::move(all));
  }

  std::optional<VariableFreeFlight> FreeFlightOfLength(double /*h*/) const override { return std::nullopt; }
  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override {
    std::ranges::copy(ToState(Started(initial), num_bodies()), x.begin());
  }

 private:
  // Whether an entry of the initial state can be another: that of a disc that moves or, for a rotation, spins.
  bool IsFree(int entry) const {
    const int moves = 4 * num_bodies();
    return entry < moves ? !scene_.bodies[entry / 4].fixed : scene_.bodies[(entry - moves) / kSpin].Spins();
  }
  // Returns an initial state in which fixed discs are at rest, or on their paths.
  std::vector<double> Started(std::span<const double> initial) const {
    std::vector<double> x(initial.begin(), initial.end());
    const std::vector<double> given = InitialState(scene_);
    for (int i = 0; i < num_bodies(); ++i) {
      const bool on_path = scene_.bodies[i].path.has_value();
      const int first = on_path ? 4 * i : scene_.bodies[i].fixed ? 4 * i + 2 : 4 * i + 4;
      std::copy(given.begin() + first, given.begin() + 4 * i + 4, x.begin() + first);
    }
    return x;
  }
  // Returns the entry of a state (simulator.h) that each entry of an initial state is.
  std::vector<int> PlacesInState() const {
    std::vector<double> entries(state_size());
    for (int i = 0; i < state_size(); ++i) entries[i] = i;
    std::vector<int> places;
    for (const double entry : ToInitial(entries, num_bodies())) places.push_back(static_cast<int>(entry));
    return places;
  }

  // Returns a row of StepLinearization::Island::P for an island of all discs from derivatives by the system's
  // parameters.
  Eigen::RowVectorXd ColumnsOf(const double* by) const {
    std::vector<double> row = {by[places_.Restitution(0)], by[places_.Friction(0)], 0, 0};
    for (int i = 0; i < num_bodies(); ++i) row.push_back(by[places_.Mass(i)]);
    for (int i = 0; i < num_bodies() && scene_.Spins(); ++i) {
      const double moment = scene_.bodies[i].Spins() ? scene_.bodies[i].MomentOfInertia() : 0.0;
      row.push_back(-moment * moment * by[places_.Inertia(i)]);  // by the inverse
    }
    row.insert(row.end(), by + places_.Restitution(1), by + places_.Gravity());
    row.insert(row.end(), by + places_.Drag(0), by + places_.Drag(num_bodies()));
    return Eigen::Map<Eigen::RowVectorXd>(row.data(), std::ssize(row));
  }

  void SetParameters(std::span<const double> cotangent, ParameterGradient* out) const {
    HybridSimulator motion(SceneSystemOf(RemoveObjective(scene_), SceneParameters::kAll));
    HybridInput input = input_;
    input.parameters.assign(places_.size(), 0.0);
    HybridGradient gradient;
    gradient.initial.assign(initial_size(), NAN);
    gradient.parameters.assign(places_.size(), NAN);
    if (motion.RolloutAccurately(input)) gradient = motion.Adjoint(ToInitial(cotangent, num_bodies()));
    const std::vector<double>& by = gradient.parameters;
    *out = {};
    out->restitution = by[places_.Restitution(0)];
    out->friction = by[places_.Friction(0)];
    for (int pair = 0; pair < places_.num_pairs && !scene_.materials.empty(); ++pair) {
      out->pairs.push_back({by[places_.Restitution(pair)], by[places_.Friction(pair)]});
    }
    out->gravity = {by[places_.Gravity()], by[places_.Gravity() + 1]};
    out->mass.assign(&by[places_.Mass(0)], &by[places_.Mass(0)] + num_bodies());
    if (scene_.Spins()) out->inertia.assign(&by[places_.Inertia(0)], &by[places_.Inertia(0)] + num_bodies());
    out->drag.assign(&by[places_.Drag(0)], &by[places_.Drag(0)] + num_bodies());
    // A constant force on a disc is one more in every interval.
    const HybridGradient pushed = ForceGradient(cotangent);
    out->force.assign(num_bodies(), Vec2d::Zero());
    const std::size_t width = pushed_.control_width();
    for (std::size_t k = 0; k < pushed.control.size(); k += width) {
      for (std::size_t c = 0; c < pushed_.control.bodies.size(); ++c) {
        out->force[pushed_.control.bodies[c]] += Vec2d(pushed.control[k + 2 * c], pushed.control[k + 2 * c + 1]);
      }
    }
    for (const auto& [parameter, min, max, moved] : scene_.design) {
      const bool position = parameter.kind == SceneParameter::Kind::kPosition;
      const double at_start = position ? gradient.initial[4 * parameter.body + parameter.component] : NAN;
      out->design.push_back(SceneParameterDerivative(scene_, parameter, *out).value_or(at_start));
    }
  }
  // Returns the gradient by a force on every disc in each interval of the last rollout.
  HybridGradient ForceGradient(std::span<const double> cotangent) const {
    HybridSimulator motion(SceneSystemOf(pushed_, SceneParameters::kNone));
    HybridInput input = input_;
    input.control.clear();
    std::vector<double> force(force_size());
    for (int k = 0; k < num_steps_; ++k) {
      ExpandForce(input_.control, k, force);
      AppendPushes(force, &input.control);
    }
    if (motion.RolloutAccurately(input)) return motion.Adjoint(ToInitial(cotangent, num_bodies()));
    HybridGradient none;
    none.control.assign(input.control.size(), NAN);
    return none;
  }

  HybridInput OneStep(std::span<const double> x, std::span<const double> force) const {
    HybridInput input{.initial = ToInitial(x, num_bodies()), .duration = step()};
    AppendPushes(force, &input.control);
    return input;
  }
  // Appends the control of pushed_ that has the forces of a step.
  void AppendPushes(std::span<const double> force, std::vector<double>* control) const {
    for (const int body : pushed_.control.bodies) {
      control->insert(control->end(), {force[2 * body], force[2 * body + 1]});
    }
    for (const int body : pushed_.control.torque_bodies) control->push_back(force[2 * num_bodies() + body]);
  }

  // Whether a guard is that of a pair, and not of a time at which steps end.
  bool IsPair(int guard) const { return guard < std::ssize(pairs_); }
  Vec2d VelocityOfPlane(int plane, double time) const {
    const std::optional<PrescribedMotion>& motion = scene_.planes[plane].motion;
    return motion ? PathMotion(*motion).SampleAt(time).velocity : Vec2d::Zero();
  }
  // Returns the touch of a pair at a time of a motion of equal steps.
  StepTouch TouchAt(const Candidate& pair, double time, int num_steps) const {
    const int k = std::clamp(static_cast<int>(time / step()), 0, num_steps - 1);
    return {k, {.candidate = pair, .time = std::clamp(time - k * step(), 0.0, step())}};
  }
  std::vector<StepTouch> TouchesOf(const HybridSimulator& motion, int num_steps) const {
    std::vector<StepTouch> touches;
    for (const HybridEvent& event : motion.events()) {
      if (!IsPair(event.guard)) continue;
      const Candidate& pair = pairs_[event.guard];
      touches.push_back(TouchAt(pair, event.time, num_steps));
      if (event.before.empty()) continue;
      const double* x = event.before.data();
      const auto two = [&](int i) { return Vec2d(x[i], x[i + 1]); };
      const ImpactConstants law = MakeImpactConstants(scene_, pair);
      std::array<double, 2> spin = {0, 0};
      if (scene_.Spins()) spin[0] = x[4 * num_bodies() + kSpin * pair.a + 1];
      if (scene_.Spins() && !pair.plane) spin[1] = x[4 * num_bodies() + kSpin * pair.b + 1];
      const Vec2d normal = pair.plane ? MakeHalfPlane(scene_.planes[pair.b]).normal
                                      : Separate<double>(two(4 * pair.a), two(4 * pair.b)).normal;
      const Vec2d w = two(4 * pair.a + 2) - (pair.plane ? VelocityOfPlane(pair.b, event.time) : two(4 * pair.b + 2));
      touches.back().touch.mode = MakeImpact<double>(law, normal, w, spin).mode;
    }
    for (const HybridGrazing& grazing : motion.grazings()) {
      if (!IsPair(grazing.guard)) continue;
      touches.push_back(TouchAt(pairs_[grazing.guard], grazing.time, num_steps));
      touches.back().touch.kind = ContactKind::kGrazing;
    }
    std::ranges::stable_sort(touches, {}, [](const StepTouch& at) { return std::pair(at.step, at.touch.time); });
    return touches;
  }

  const ModelTraits& traits_;
  const Scene pushed_;
  const std::vector<Candidate> pairs_;
  const ParameterPlaces places_;
  HybridSimulator motion_;
  HybridInput input_;  // of the last rollout
  std::vector<StepTouch> touches_;
  std::string why_;
};

}  // namespace

std::string UnsupportedByIntegratedScene(const Scene& scene) {
  const std::string beyond = UnsupportedByHybridProblem(RemoveObjective(scene));
  return beyond.empty() ? ""
                        : "the scene has " + NonBallisticForces(scene) + " beside " + beyond +
                              ", for which the times of impacts are not found: use a time-stepping model such as lcp";
}

std::unique_ptr<Simulator> MakeIntegratedScene(const Scene& scene, const ModelTraits& event) {
  return std::make_unique<IntegratedScene>(scene, event);
}

}  // namespace saltus
