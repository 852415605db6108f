// A moving plane stands for a fixed disc behind it for each disc that moves, which it would touch where it touches the
// plane: in each step its centre is on the normal through the centre of that disc, and it moves as the plane does. So
// time-stepping models have moving planes as they have moving discs. Within a step its surface turns away from the
// plane by a part of second order in the length of the step. It is so small that discs beside that disc do not reach
// it.
#include "simulate/forced_simulator.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "saltus/scene/materials.h"
#include "scene/path_motion.h"
#include "simulate/impact.h"
#include "simulate/parameter_derivative.h"
#include "simulate/state_forces.h"

namespace saltus {
namespace {

constexpr double kBehind = 10;  // radius of a disc behind a plane, in radii of the disc before it

// The disc behind a moving plane that a disc touches in its place.
struct Backing {
  int disc = 0, plane = 0;
};

std::vector<Backing> BackingsOf(const Scene& scene) {
  std::vector<Backing> backings;
  for (int plane = 0; plane < std::ssize(scene.planes); ++plane) {
    for (int disc = 0; disc < scene.num_bodies() && scene.planes[plane].motion; ++disc) {
      if (!scene.bodies[disc].fixed) backings.push_back({disc, plane});
    }
  }
  return backings;
}

class ForcedSimulator final : public Simulator {
 public:
  ForcedSimulator(const Scene& scene, std::unique_ptr<Simulator> inner)
      : Simulator(scene, inner->precision(), scene.steps / inner->num_steps()),
        inner_(std::move(inner)),
        backings_(BackingsOf(scene)),
        at_rest_(inner_->state_size()) {
    for (const Body& body : scene_.bodies) {
      paths_.push_back(body.path ? std::optional(PathMotion(*body.path)) : std::nullopt);
    }
    for (int plane = 0; plane < std::ssize(scene_.planes); ++plane) {
      const std::optional<PrescribedMotion>& motion = scene_.planes[plane].motion;
      motions_.push_back(motion ? std::optional(PathMotion(*motion)) : std::nullopt);
      if (!motion) still_planes_.push_back(plane);
    }
    inner_->ExpandInitial(InitialState(inner_->scene()), at_rest_);
  }

  const ModelTraits& traits() const override { return inner_->traits(); }
  int body_size() const override { return inner_->body_size(); }
  std::size_t LeastMemory() const override { return (num_steps_ + std::size_t{1}) * state_size() * sizeof(double); }
  const std::vector<StepTouch>& touches() const override { return touches_; }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override {
    states_.resize((num_steps_ + std::size_t{1}) * state_size());
    control_.assign(control.begin(), control.end());
    touches_.clear();
    failure_.reset();
    ExpandInitial(initial, State(0));
    std::vector<double> force(force_size());
    std::vector<Touch> touches;
    for (int k = 0; k < num_steps_; ++k) {
      if (stopped()) return false;
      touches.clear();
      ExpandForce(control, k, force);
      StepAt(k, State(k), force, State(k + 1), &touches);
      for (const Touch& touch : touches) touches_.push_back({k, touch});
      if (std::ranges::all_of(State(k + 1), [](double value) { return std::isfinite(value); })) continue;
      failure_ = {k, -1, "the step has no result: its iterations do not converge, or the state is not finite"};
      return false;
    }
    return true;
  }

  void GetState(int k, std::span<double> x) const override { std::ranges::copy(State(k), x.begin()); }

  void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) override {
    std::vector<double> after(cotangent.begin(), cotangent.end()), before(after.size());
    std::vector<double> force(force_size()), by_force(force_size());
    if (out.parameters != nullptr) Clear(out.parameters);
    for (int k = num_steps_; k-- > 0;) {
      if (stopped()) return;
      ExpandForce(control_, k, force);
      const Linear step = LinearizeInner(k, State(k), force, out.parameters != nullptr);
      PullBack(step, State(k), after, before, by_force);
      if (out.parameters != nullptr) AddParameters(step, State(k), after, by_force, out.parameters);
      after.swap(before);
      if (out.control.empty()) continue;
      const std::size_t first = scene_.ForceIndex(k, 0), width = control_width();
      SelectControl(by_force, out.control.subspan(first, width));
      for (std::size_t i = first; i < first + width && out.factor != 0; ++i) {
        out.control[i] += out.factor * out.addend[i];
      }
    }
    for (const auto& [parameter, min, max, moved] : scene_.design) {
      if (out.parameters == nullptr) break;
      const bool position = parameter.kind == SceneParameter::Kind::kPosition;
      const double at_start = position ? after[parameter.body * body_size() + parameter.component] : NAN;
      out.parameters->design.push_back(SceneParameterDerivative(scene_, parameter, *out.parameters).value_or(at_start));
    }
    const std::size_t moves = 4 * std::size_t(num_bodies());
    const std::vector<double> initial =
        out.initial.empty() ? std::vector<double>() : ToInitial(Known(after), num_bodies());
    for (std::size_t i = 0; i < out.initial.size(); ++i) {
      const Body& body = scene_.bodies[i < moves ? i / 4 : (i - moves) / kSpin];
      out.initial[i] = body.fixed || (i >= moves && !body.Spins()) ? 0.0 : initial[i];
    }
  }

  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override {
    StepAt(0, x, force, next, touches);
  }

  // All discs are in one island, as springs connect discs that do not touch.
  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override {
    const Linear step = LinearizeInner(0, x, force, with_parameters);
    StepLinearization& out = *linearization = {};
    out.body_size = body_size();
    out.inverse_mass.assign(step.inner.inverse_mass.begin(), step.inner.inverse_mass.begin() + num_bodies());
    out.has_torques = step.inner.has_torques;
    StepLinearization::Island all;
    for (int i = 0; i < num_bodies(); ++i) all.bodies.push_back(i);
    all.A.resize(state_size(), state_size());
    all.B.resize(state_size(), force_size());
    std::vector<double> after(state_size()), before(state_size()), by_force(force_size());
    for (int row = 0; row < state_size(); ++row) {
      after[row] = 1;
      PullBack(step, x, after, before, by_force);
      after[row] = 0;
      all.A.row(row) = Eigen::Map<const Eigen::RowVectorXd>(before.data(), state_size());
      all.B.row(row) = Eigen::Map<const Eigen::RowVectorXd>(by_force.data(), force_size());
    }
    if (with_parameters) all.P = ParametersOf(step, x);
    out.islands.push_back(std::move(all));
  }

  std::optional<VariableFreeFlight> FreeFlightOfLength(double /*h*/) const override { return std::nullopt; }
  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override {
    const Scene& inner = inner_->scene();
    std::vector<double> more = InitialState(inner), expanded(inner_->state_size());
    std::copy_n(initial.begin(), 4 * num_bodies(), more.begin());
    std::copy(initial.begin() + 4 * num_bodies(), initial.end(), more.begin() + 4 * inner.num_bodies());
    inner_->ExpandInitial(more, expanded);
    std::copy_n(expanded.begin(), state_size(), x.begin());
    PutOnPaths(0, x);
  }

 private:
  // The linearization of a step of the inner simulator, and the forces in it.
  struct Linear {
    StepLinearization inner;
    std::vector<double> force;
  };

  std::span<double> State(int k) { return std::span(states_).subspan(k * std::size_t(state_size()), state_size()); }
  std::span<const double> State(int k) const {
    return std::span(states_).subspan(k * std::size_t(state_size()), state_size());
  }
  // Returns the part of a state of a scene without rotations of a model's own.
  std::vector<double> Known(std::span<const double> x) const {
    const int size = InitialSize(scene_) / num_bodies();
    std::vector<double> known;
    for (int i = 0; i < num_bodies(); ++i) {
      known.insert(known.end(), x.begin() + i * body_size(), x.begin() + i * body_size() + size);
    }
    return known;
  }
  Vec2d NormalOf(int plane) const { return MakeHalfPlane(scene_.planes[plane]).normal; }

  // Puts discs that have paths where they are at the beginning of step k.
  void PutOnPaths(int k, std::span<double> x) const {
    for (int i = 0; i < num_bodies(); ++i) {
      if (!paths_[i]) continue;
      const PathMotion::Point at = paths_[i]->SampleAt(k * step());
      std::copy_n(at.position.data(), 2, &x[i * body_size()]);
      std::copy_n(at.velocity.data(), 2, &x[i * body_size() + 2]);
    }
  }
  // Returns the state in which the inner simulator begins step k.
  std::vector<double> InnerState(int k, std::span<const double> x) const {
    std::vector<double> inner = at_rest_;
    std::ranges::copy(x, inner.begin());
    const auto put = [&](int body, const Vec2d& position, const PathMotion& path) {
      const Vec2d way = path.SampleAt((k + 1) * step()).position - path.SampleAt(k * step()).position,
                  mean = way / step();
      std::copy_n(position.data(), 2, &inner[body * body_size()]);
      std::copy_n(mean.data(), 2, &inner[body * body_size() + 2]);
    };
    for (int i = 0; i < num_bodies(); ++i) {
      if (paths_[i]) put(i, paths_[i]->SampleAt(k * step()).position, *paths_[i]);
    }
    for (int g = 0; g < std::ssize(backings_); ++g) {
      const auto& [disc, plane] = backings_[g];
      const Vec2d p(x[disc * body_size()], x[disc * body_size() + 1]), n = NormalOf(plane);
      const double distance = Dot(n, Vec2d(p - motions_[plane]->SampleAt(k * step()).position));
      put(num_bodies() + g, p - (distance + kBehind * scene_.bodies[disc].radius) * n, *motions_[plane]);
    }
    return inner;
  }
  // Returns the forces of a step on all discs of the inner simulator, with those at the state x.
  std::vector<double> InnerForce(std::span<const double> x, std::span<const double> force) const {
    std::vector<double> inner(inner_->force_size());
    const std::ptrdiff_t moves = 2 * num_bodies();
    std::copy_n(force.begin(), moves, inner.begin());
    std::copy(force.begin() + moves, force.end(), inner.begin() + 2 * inner_->num_bodies());
    for (const StateForce& one : scene_.forces) {
      const ForceAtState at = ForceAt(one, x, body_size());
      for (int j = 0; j < 2; ++j) {
        inner[2 * at.body + j] += at.value[j];
        if (at.other >= 0) inner[2 * at.other + j] -= at.value[j];
      }
    }
    return inner;
  }
  // Returns a touch with the indices of this scene.
  Candidate ToSceneIndices(Candidate c) const {
    const int walls = static_cast<int>(still_planes_.size());
    if (!c.plane && c.b >= num_bodies()) return {c.a, backings_[c.b - num_bodies()].plane, true};
    if (c.plane) c.b = c.b < walls ? still_planes_[c.b] : c.b + static_cast<int>(scene_.planes.size()) - walls;
    return c;
  }

  void StepAt(int k, std::span<const double> x, std::span<const double> force, std::span<double> next,
              std::vector<Touch>* touches) const {
    std::vector<double> inner(inner_->state_size());
    const std::size_t known = touches == nullptr ? 0 : touches->size();
    inner_->Step(InnerState(k, x), InnerForce(x, force), inner, touches);
    std::copy_n(inner.begin(), state_size(), next.begin());
    PutOnPaths(k + 1, next);
    for (std::size_t i = known; touches != nullptr && i < touches->size(); ++i) {
      (*touches)[i].candidate = ToSceneIndices((*touches)[i].candidate);
    }
  }

  Linear LinearizeInner(int k, std::span<const double> x, std::span<const double> force, bool with_parameters) const {
    Linear step{.inner = {}, .force = InnerForce(x, force)};
    inner_->Linearize(InnerState(k, x), step.force, with_parameters, &step.inner);
    return step;
  }

  // Computes the cotangents of the state x in which a step begins, and of the forces in it, from that of the state
  // after.
  void PullBack(const Linear& step, std::span<const double> x, std::span<const double> after, std::span<double> before,
                std::span<double> by_force) const {
    std::vector<double> inner_after(inner_->state_size()), inner(inner_->state_size()), force(inner_->force_size());
    std::ranges::copy(after, inner_after.begin());
    for (int i = 0; i < num_bodies(); ++i) {
      if (paths_[i]) std::fill_n(inner_after.begin() + i * body_size(), body_size(), 0.0);
    }
    step.inner.ApplyTranspose(inner_after, inner, force);
    std::copy_n(inner.begin(), state_size(), before.begin());
    for (int g = 0; g < std::ssize(backings_); ++g) {
      const auto& [disc, plane] = backings_[g];
      const double* of_backing = &inner[(num_bodies() + g) * body_size()];
      const Vec2d by(of_backing[0], of_backing[1]), n = NormalOf(plane), along = by - Dot(n, by) * n;
      for (int j = 0; j < 2; ++j) before[disc * body_size() + j] += along[j];
    }
    for (const StateForce& one : scene_.forces) {
      const ForceAtState at = ForceAt(one, x, body_size());
      Eigen::Vector2d by(force[2 * at.body], force[2 * at.body + 1]);
      if (at.other >= 0) by -= Eigen::Vector2d(force[2 * at.other], force[2 * at.other + 1]);
      const Eigen::Vector4d through = at.by.transpose() * by;
      for (int i = 0; i < 4; ++i) {
        before[body_size() * at.body + i] += through[i];
        if (at.other >= 0) before[body_size() * at.other + i] -= through[i];
      }
    }
    for (int i = 0; i < num_bodies(); ++i) {
      if (paths_[i]) std::fill_n(before.begin() + i * body_size(), body_size(), 0.0);
    }
    const std::ptrdiff_t moves = 2 * num_bodies();
    std::copy_n(force.begin(), moves, by_force.begin());
    std::copy_n(force.begin() + 2 * inner_->num_bodies(), by_force.size() - moves, by_force.begin() + moves);
  }

  // The columns of StepLinearization::Island::P for an island of all discs.
  int NumParameters() const {
    const auto pairs = static_cast<int>(PairContactsOf(scene_).size());
    return 4 + (scene_.Spins() ? 3 : 2) * num_bodies() + 2 * std::max(pairs - 1, 0);
  }
  int FirstDrag() const { return NumParameters() - num_bodies(); }
  Eigen::MatrixXd ParametersOf(const Linear& step, std::span<const double> x) const {
    Eigen::MatrixXd P = Eigen::MatrixXd::Zero(state_size(), NumParameters());
    const int size = body_size(), kinds = scene_.Spins() ? 2 : 1;
    for (const StepLinearization::Island& island : step.inner.islands) {
      const auto n = static_cast<int>(island.bodies.size());
      for (int i = 0; i < n; ++i) {
        if (island.bodies[i] >= num_bodies()) continue;
        const auto rows = island.P.middleRows(size * i, size);
        auto out = P.middleRows(size * island.bodies[i], size);
        out.leftCols(4) = rows.leftCols(4);
        for (int j = 0; j < n; ++j) {
          if (island.bodies[j] >= num_bodies()) continue;
          for (int kind = 0; kind < kinds; ++kind) {
            out.col(4 + kind * num_bodies() + island.bodies[j]) = rows.col(4 + kind * n + j);
          }
        }
        const auto rest = rows.cols() - 4 - kinds * n;
        out.middleCols(FirstDrag() - rest, rest) = rows.rightCols(rest);
      }
    }
    Eigen::MatrixXd by_state, by_force;
    step.inner.ToDense(&by_state, &by_force);
    for (int i = 0; i < num_bodies(); ++i) {
      P.col(FirstDrag() + i) = -by_force.topRows(state_size()).middleCols(2 * i, 2) *
                               Eigen::Vector2d(x[i * body_size() + 2], x[i * body_size() + 3]);
    }
    for (std::size_t f = 0; f < step.inner.flying.size(); ++f) {
      const int body = step.inner.flying[f];
      if (body >= num_bodies()) continue;
      const double inverse_mass = step.inner.inverse_mass[body];
      for (int j = 0; j < 2; ++j) {
        const double a = -inverse_mass * inverse_mass * step.force[2 * body + j];
        P(size * body + j, 4 + body) = step.inner.free.pa * a;
        P(size * body + 2 + j, 4 + body) = step.inner.free.va * a;
      }
      if (!step.inner.has_torques || !scene_.bodies[body].Spins()) continue;
      const double turn = scene_.bodies[body].MomentOfInertia() * step.force[2 * inner_->num_bodies() + body];
      P.block<2, 1>(size * body + 4, 4 + num_bodies() + body) = turn * step.inner.by_torque[f];
    }
    return P;
  }

  void Clear(ParameterGradient* parameters) const {
    *parameters = {};
    parameters->pairs.assign(PairContactsOf(scene_).size(), {0, 0});
    parameters->mass.assign(num_bodies(), 0.0);
    parameters->force.assign(num_bodies(), Vec2d::Zero());
    parameters->inertia.assign(scene_.Spins() ? num_bodies() : 0, 0.0);
    parameters->drag.assign(num_bodies(), 0.0);
  }

  void AddParameters(const Linear& step, std::span<const double> x, std::span<const double> after,
                     std::span<const double> by_force, ParameterGradient* out) const {
    const Eigen::Map<const Eigen::RowVectorXd> cotangent(after.data(), static_cast<Eigen::Index>(after.size()));
    const Eigen::RowVectorXd by = cotangent * ParametersOf(step, x);
    out->restitution += by[0];
    out->friction += by[1];
    out->stiffness += by[2];
    out->damping += by[3];
    for (int i = 0; i < num_bodies(); ++i) {
      if (scene_.bodies[i].fixed) continue;
      const Vec2d push(by_force[2 * i], by_force[2 * i + 1]);
      out->force[i] += push;
      out->gravity += scene_.bodies[i].mass * push;
      out->drag[i] += by[FirstDrag() + i];
      out->mass[i] += by[4 + i];
      if (!scene_.bodies[i].Spins()) continue;
      const double inverse = 1 / scene_.bodies[i].MomentOfInertia();
      out->inertia[i] -= by[4 + num_bodies() + i] * inverse * inverse;
    }
    const Eigen::Index first = FirstDrag() - 2 * (std::ssize(out->pairs) - 1);
    for (std::size_t k = 0; k < out->pairs.size(); ++k) {
      const Eigen::Index at = k == 0 ? 0 : first + 2 * (static_cast<Eigen::Index>(k) - 1);
      out->pairs[k].restitution += by[at];
      out->pairs[k].friction += by[at + 1];
    }
  }

  const std::unique_ptr<Simulator> inner_;
  const std::vector<Backing> backings_;                     // the discs of the inner scene behind those of this scene
  std::vector<double> at_rest_;                             // a state of the inner simulator
  std::vector<std::optional<PathMotion>> paths_, motions_;  // of each disc, and of each plane
  std::vector<int> still_planes_;                           // which the planes of the inner scene are
  std::vector<double> states_, control_;
  std::vector<StepTouch> touches_;
};

}  // namespace

Scene RemoveForces(const Scene& scene) {
  Scene still = scene;
  still.forces.clear();
  still.design.clear();
  still.no_contact.clear();
  for (Body& body : still.bodies) body.path.reset();
  for (const auto& [disc, plane] : BackingsOf(scene)) {
    Body& behind = still.bodies.emplace_back();
    behind.radius = kBehind * scene.bodies[disc].radius;
    behind.fixed = true;
    behind.material = scene.planes[plane].material;
  }
  std::erase_if(still.planes, [](const Plane& plane) { return plane.motion.has_value(); });
  return still;
}

std::unique_ptr<Simulator> AddForces(const Scene& scene, std::unique_ptr<Simulator> inner) {
  return std::make_unique<ForcedSimulator>(scene, std::move(inner));
}

}  // namespace saltus
