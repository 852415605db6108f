// The one place where contact models meet Jets.
//
// ModelSimulator steps a whole scene with plain scalars and records what touched. Derivatives follow from that record:
// discs that fly have a constant Jacobian, found once by differentiating the model's free flight; discs that touch are
// grouped into islands, and the model's own step is run on each island with Jets, kJetWidth directions a pass.
#pragma once

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory_resource>
#include <utility>

#include "saltus/dynamics/broad_phase.h"
#include "saltus/dynamics/simulator.h"

namespace saltus {

template <ContactModel M, typename S>
class ModelSimulator final : public Simulator {
 public:
  static constexpr int kRotation = M::kRotation;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;
  static_assert(sizeof(State) == kSize * sizeof(S));

  ModelSimulator(const Scene& scene, Precision precision, M model = {})
      : Simulator(scene, precision, M::kTraits.grid_steps),
        model_(std::move(model)),
        contact_{S(scene.contact.restitution),
                 S(scene.contact.friction),
                 S(scene.contact.stiffness),
                 S(scene.contact.damping)} {
    for (const Body& body : scene.bodies) {
      const S mass = S(body.mass);
      bodies_.push_back({mass, body.fixed ? S(0) : S(1) / mass, S(body.radius), body.fixed});
      fixed_.push_back(body.fixed);
    }
    for (const Plane& plane : scene.planes) {
      const Vec2d normal = plane.normal.normalized();
      planes_.push_back({normal.cast<S>(), S(Dot(normal, plane.point))});
      wide_planes_.push_back({normal, Dot(normal, plane.point)});
    }
    free_ = DifferentiateFreeFlight();
  }

  const ModelTraits& traits() const override {
    static constexpr ModelTraits kTraits = M::kTraits;
    return kTraits;
  }
  int body_size() const override { return kSize; }
  const std::vector<StepTouch>& touches() const override { return touches_; }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override {
    CHECK_EQ(static_cast<int>(initial.size()), 4 * num_bodies());
    CHECK_EQ(static_cast<int>(control.size()), control_size());
    control_.assign(control.begin(), control.end());
    trajectory_.resize(static_cast<size_t>(num_steps_ + 1) * num_bodies());
    touches_.clear();
    Expand(initial, trajectory_.data());

    Workspace& work = workspace_;
    work.force.assign(num_bodies(), Vec2<S>::Zero());
    const std::vector<double> push = LargestAccelerations();
    BroadPhase broad_phase(wide_planes_, step(), M::kTraits.chains, M::kTraits.reach);
    int quiet_until = 0;
    for (int k = 0; k < num_steps_; ++k) {
      const std::span<const State> x = StateAt(k);
      SetForce(k, work.force);
      work.candidates.clear();
      if (k >= quiet_until) {
        quiet_until = k + broad_phase.Find(Discs(x, push, &work), &work.candidates);
      }
      StepInput<S> in = Input(work);
      if (work.candidates.empty()) {
        FreeFlight(model_, in, x, MutableStateAt(k + 1));
        continue;
      }
      work.touches.clear();
      in.touches = &work.touches;
      model_.Step(in, x, MutableStateAt(k + 1));
      work.scratch.release();
      for (const Touch& touch : work.touches) touches_.push_back({k, touch});
    }
    return AllFinite(StateAt(num_steps_));
  }

  void GetState(int k, std::span<double> x) const override {
    const S* flat = Flat(StateAt(k).data());
    std::copy(flat, flat + state_size(), x.begin());
  }

  void Adjoint(std::span<const double> cotangent, bool with_parameters, Sensitivity* sensitivity) override {
    CHECK_EQ(static_cast<int>(cotangent.size()), state_size());
    Sensitivity& out = *sensitivity;
    out.initial.assign(4 * num_bodies(), 0.0);
    out.control.resize(control_size());
    out.parameters = ParameterGradient();
    out.parameters.mass.assign(num_bodies(), 0.0);
    out.parameters.force.assign(num_bodies(), Vec2d::Zero());

    std::vector<S>& lambda = lambda_;
    lambda.assign(cotangent.begin(), cotangent.end());
    push_.resize(num_bodies());
    Workspace& work = workspace_;
    work.force.assign(num_bodies(), Vec2<S>::Zero());
    int end = static_cast<int>(touches_.size());
    for (int k = num_steps_ - 1; k >= 0; --k) {
      int begin = end;
      while (begin > 0 && touches_[begin - 1].step == k) --begin;
      if (begin < end || with_parameters) SetForce(k, work.force);

      work.flying.assign(num_bodies(), 1);
      if (begin < end) {
        work.touches.clear();
        for (int i = begin; i < end; ++i) work.touches.push_back(touches_[i].touch);
        AdjointOfIslands(k, with_parameters, &work, &out.parameters);
      }
      for (int i = 0; i < num_bodies(); ++i) {
        if (!work.flying[i] || bodies_[i].fixed) continue;
        const Vec2<S> acceleration = AdjointOfFlight(&lambda[i * kSize]);
        push_[i] = Scale(bodies_[i].inverse_mass, acceleration);
        if (with_parameters) {
          out.parameters.mass[i] -= Dot(push_[i], work.force[i]) * bodies_[i].inverse_mass;
        }
        if constexpr (kRotation > 0) AdjointOfRotation(k, i, &lambda[i * kSize + 4]);
      }
      double* gradient = out.control.data() + static_cast<size_t>(k) * num_controlled() * 2;
      for (int body : scene_.control.bodies) {
        *gradient++ = push_[body][0];
        *gradient++ = push_[body][1];
      }
      if (with_parameters) AddUniformForce(&out.parameters);
      end = begin;
    }
    for (int i = 0; i < num_bodies(); ++i) {
      for (int j = 0; j < 4 && !bodies_[i].fixed; ++j) out.initial[4 * i + j] = lambda[i * kSize + j];
    }
  }

  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override {
    Workspace work;
    std::vector<State> from(num_bodies()), to(num_bodies());
    StepOnce(x, force, &work, &from, &to);
    std::copy(Flat(to.data()), Flat(to.data()) + state_size(), next.begin());
    if (touches != nullptr) *touches = work.touches;
  }

  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override {
    Workspace work;
    std::vector<State> from(num_bodies()), to(num_bodies());
    StepOnce(x, force, &work, &from, &to);

    StepLinearization& out = *linearization;
    out.body_size = kSize;
    out.free = {
        double(free_.pp), double(free_.pv), double(free_.pa), double(free_.vp), double(free_.vv), double(free_.va)};
    out.inverse_mass.assign(num_bodies(), 0.0);
    for (int i = 0; i < num_bodies(); ++i) out.inverse_mass[i] = bodies_[i].inverse_mass;
    out.islands.clear();
    out.flying.clear();
    out.rotation.clear();
    work.flying.assign(num_bodies(), 1);
    for (const std::vector<int>& island : IslandsOf(work)) {
      for (int i : island) work.flying[i] = 0;
      DifferentiateIsland(from, island, with_parameters, &work);
      const int n = static_cast<int>(island.size());
      const Eigen::MatrixXd jacobian = work.Jacobian(n, with_parameters).template cast<double>();
      out.islands.push_back({island,
                             jacobian.leftCols(n * kSize),
                             jacobian.middleCols(n * kSize, 2 * n),
                             jacobian.rightCols(jacobian.cols() - n * (kSize + 2))});
    }
    for (int i = 0; i < num_bodies(); ++i) {
      if (!work.flying[i]) continue;
      out.flying.push_back(i);
      if constexpr (kRotation > 0) out.rotation.push_back(RotationJacobian(i, from[i]).template cast<double>());
    }
  }

  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override {
    std::vector<State> state(num_bodies());
    Expand(initial, state.data());
    std::copy(Flat(state.data()), Flat(state.data()) + state_size(), x.begin());
  }

 private:
  using Jet = StepJet<S>;
  using JetState = BodyState<Jet, kRotation>;
  using Matrix = Eigen::Matrix<S, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using RotationMatrix = Eigen::Matrix<S, kRotation, kRotation>;

  struct FreeCoefficients {
    S pp, pv, pa, vp, vv, va;
  };

  // Everything a step or a sweep needs besides the trajectory; reused, so that neither allocates.
  struct Workspace {
    std::array<std::byte, 1 << 14> buffer;
    std::pmr::monotonic_buffer_resource scratch{buffer.data(), buffer.size()};
    std::vector<BroadPhase::Disc> discs;
    std::vector<Candidate> candidates;
    std::vector<Touch> touches;
    std::vector<Vec2<S>> force;
    std::vector<char> flying;
    std::vector<int> local;  // scene index to island index
    // One island with Jets.
    std::vector<JetState> x, next;
    std::vector<BodyConstants<Jet>> bodies;
    std::vector<Vec2<Jet>> jet_force;
    std::vector<Candidate> island_candidates;
    std::vector<S> jacobian;  // (n * kSize) x columns, row by row
    std::vector<S> cotangent;

    static int Columns(int n, bool with_parameters) { return n * (kSize + 2) + (with_parameters ? 4 + n : 0); }
    Eigen::Map<Matrix> Jacobian(int n, bool with_parameters) {
      return {jacobian.data(), n * kSize, Columns(n, with_parameters)};
    }
  };

  std::span<const State> StateAt(int k) const {
    return {trajectory_.data() + static_cast<size_t>(k) * num_bodies(), static_cast<size_t>(num_bodies())};
  }
  std::span<State> MutableStateAt(int k) {
    return {trajectory_.data() + static_cast<size_t>(k) * num_bodies(), static_cast<size_t>(num_bodies())};
  }
  static const S* Flat(const State* x) { return reinterpret_cast<const S*>(x); }
  static S* Flat(State* x) { return reinterpret_cast<S*>(x); }

  bool AllFinite(std::span<const State> x) const {
    return std::all_of(Flat(x.data()), Flat(x.data()) + state_size(), [](S value) { return std::isfinite(value); });
  }

  void Expand(std::span<const double> initial, State* x) const {
    for (int i = 0; i < num_bodies(); ++i) {
      const double* from = &initial[4 * i];
      x[i].p = Vec2<S>(S(from[0]), S(from[1]));
      x[i].v = bodies_[i].fixed ? Vec2<S>::Zero() : Vec2<S>(S(from[2]), S(from[3]));
      if constexpr (kRotation > 0) {
        double rotation[kRotation] = {};
        if constexpr (requires { M::InitialRotation(rotation); }) M::InitialRotation(rotation);
        std::copy(rotation, rotation + kRotation, x[i].rotation);
      }
    }
  }

  void SetForce(int k, std::span<Vec2<S>> force) const {
    const S* u = control_.data() + static_cast<size_t>(k) * num_controlled() * 2;
    for (int body : scene_.control.bodies) {
      force[body] = Vec2<S>(u[0], u[1]);
      u += 2;
    }
  }

  // Bound on each disc's acceleration over the whole rollout, m/s^2.
  std::vector<double> LargestAccelerations() const {
    const double gravity = scene_.gravity.norm();
    std::vector<double> push(num_bodies(), gravity);
    for (int c = 0; c < num_controlled(); ++c) {
      double largest = 0;
      for (int k = 0; k < num_steps_; ++k) {
        const S* u = control_.data() + 2 * (static_cast<size_t>(k) * num_controlled() + c);
        largest = std::max(largest, double(u[0] * u[0] + u[1] * u[1]));
      }
      const int body = scene_.control.bodies[c];
      push[body] += std::sqrt(largest) * double(bodies_[body].inverse_mass);
    }
    return push;
  }

  std::span<const BroadPhase::Disc> Discs(std::span<const State> x, std::span<const double> push,
                                          Workspace* work) const {
    work->discs.resize(num_bodies());
    for (int i = 0; i < num_bodies(); ++i) {
      work->discs[i] = {x[i].p.template cast<double>(),
                        x[i].v.template cast<double>(),
                        push[i],
                        double(bodies_[i].radius),
                        double(bodies_[i].mass),
                        bodies_[i].fixed};
    }
    return work->discs;
  }

  StepInput<S> Input(Workspace& work) const {
    return {.h = S(step()),
            .gravity = scene_.gravity.template cast<S>(),
            .contact = contact_,
            .bodies = bodies_,
            .planes = planes_,
            .force = work.force,
            .candidates = work.candidates,
            .scratch = &work.scratch};
  }

  // One step from a state in doubles; leaves force and touches in `work`.
  void StepOnce(std::span<const double> x, std::span<const double> force, Workspace* work, std::vector<State>* from,
                std::vector<State>* to) const {
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    CHECK_EQ(static_cast<int>(force.size()), 2 * num_bodies());
    std::copy(x.begin(), x.end(), Flat(from->data()));
    work->force.resize(num_bodies());
    std::vector<double> push(num_bodies());
    for (int i = 0; i < num_bodies(); ++i) {
      work->force[i] = Vec2<S>(S(force[2 * i]), S(force[2 * i + 1]));
      push[i] = scene_.gravity.norm() + std::hypot(force[2 * i], force[2 * i + 1]) * double(bodies_[i].inverse_mass);
    }
    BroadPhase(wide_planes_, step(), M::kTraits.chains, M::kTraits.reach)
        .Find(Discs(*from, push, work), &work->candidates);
    StepInput<S> in = Input(*work);
    in.touches = &work->touches;
    model_.Step(in, std::span<const State>(*from), std::span<State>(*to));
    work->scratch.release();
  }

  FreeCoefficients DifferentiateFreeFlight() const {
    JetState x{};
    std::array<Vec2<Jet>, 1> force;
    for (int j = 0; j < 2; ++j) {
      x.p[j] = Jet(S(0), j);
      x.v[j] = Jet(S(0), 2 + j);
      force[0][j] = Jet(S(0), 4 + j);
    }
    if constexpr (kRotation > 0) SetRotation(Expanded(), &x);
    const std::array<BodyConstants<Jet>, 1> body{{{Jet(S(1)), Jet(S(1)), S(1), false}}};
    StepInput<Jet> in{};
    in.h = S(step());
    in.gravity = Vec2<S>::Zero();
    in.bodies = body;
    in.force = force;
    const JetState next = model_.Free(in, 0, x);
    return {next.p[0].v[0], next.p[0].v[2], next.p[0].v[4], next.v[0].v[0], next.v[0].v[2], next.v[0].v[4]};
  }

  State Expanded() const {
    State x{};
    if constexpr (kRotation > 0) {
      double rotation[kRotation] = {};
      if constexpr (requires { M::InitialRotation(rotation); }) M::InitialRotation(rotation);
      std::copy(rotation, rotation + kRotation, x.rotation);
    }
    return x;
  }

  static void SetRotation(const State& from, JetState* to) {
    for (int j = 0; j < kRotation; ++j) to->rotation[j] = Jet(from.rotation[j]);
  }

  // Transforms (lambda_p, lambda_v) in place; returns the cotangent of the acceleration.
  Vec2<S> AdjointOfFlight(S* lambda) const {
    Vec2<S> acceleration;
    for (int j = 0; j < 2; ++j) {
      const S p = lambda[j];
      const S v = lambda[2 + j];
      lambda[j] = free_.pp * p + free_.vp * v;
      lambda[2 + j] = free_.pv * p + free_.vv * v;
      acceleration[j] = free_.pa * p + free_.va * v;
    }
    return acceleration;
  }

  RotationMatrix RotationJacobian(int i, const State& x) const {
    JetState jet{};
    for (int j = 0; j < 2; ++j) {
      jet.p[j] = Jet(x.p[j]);
      jet.v[j] = Jet(x.v[j]);
    }
    for (int j = 0; j < kRotation; ++j) jet.rotation[j] = Jet(x.rotation[j], j);
    const std::array<Vec2<Jet>, 1> force{Vec2<Jet>(Jet(S(0)), Jet(S(0)))};
    const std::array<BodyConstants<Jet>, 1> body{
        {{Jet(bodies_[i].mass), Jet(bodies_[i].inverse_mass), bodies_[i].radius, bodies_[i].fixed}}};
    StepInput<Jet> in{};
    in.h = S(step());
    in.gravity = Vec2<S>::Zero();
    in.bodies = body;
    in.force = force;
    const JetState next = model_.Free(in, 0, jet);
    RotationMatrix jacobian;
    for (int r = 0; r < kRotation; ++r) jacobian.row(r) = next.rotation[r].v.template head<kRotation>();
    return jacobian;
  }

  void AdjointOfRotation(int k, int i, S* lambda) const {
    Eigen::Map<Eigen::Matrix<S, kRotation, 1>> map(lambda);
    if (map.isZero(S(0))) return;
    map = (RotationJacobian(i, StateAt(k)[i]).transpose() * map).eval();
  }

  std::vector<std::vector<int>> IslandsOf(Workspace& work) const {
    work.candidates.clear();
    for (const Touch& touch : work.touches) work.candidates.push_back(touch.candidate);
    return FindIslands(work.candidates, fixed_);
  }

  void AdjointOfIslands(int k, bool with_parameters, Workspace* work, ParameterGradient* parameters) {
    for (const std::vector<int>& island : IslandsOf(*work)) {
      const int n = static_cast<int>(island.size());
      DifferentiateIsland(StateAt(k), island, with_parameters, work);
      const Eigen::Map<Matrix> jacobian = work->Jacobian(n, with_parameters);
      // Gather, transform, scatter. A fixed disc may be in several islands; what it receives is dropped in the end.
      work->cotangent.resize(n * kSize + jacobian.cols());
      Eigen::Map<Eigen::Matrix<S, Eigen::Dynamic, 1>> after(work->cotangent.data(), n * kSize);
      Eigen::Map<Eigen::Matrix<S, Eigen::Dynamic, 1>> before(work->cotangent.data() + n * kSize, jacobian.cols());
      for (int i = 0; i < n; ++i) {
        std::copy_n(&lambda_[island[i] * kSize], kSize, after.data() + i * kSize);
      }
      before.noalias() = jacobian.transpose() * after;
      for (int i = 0; i < n; ++i) {
        const int body = island[i];
        std::copy_n(before.data() + i * kSize, kSize, &lambda_[body * kSize]);
        push_[body] = before.template segment<2>(n * kSize + 2 * i);
        work->flying[body] = 0;
      }
      if (!with_parameters) continue;
      const auto p = before.tail(4 + n);
      parameters->restitution += p[0];
      parameters->friction += p[1];
      parameters->stiffness += p[2];
      parameters->damping += p[3];
      for (int i = 0; i < n; ++i) {
        if (!bodies_[island[i]].fixed) parameters->mass[island[i]] += p[4 + i];
      }
    }
  }

  // Gravity and a constant force act in every step as the step's own force does.
  void AddUniformForce(ParameterGradient* parameters) const {
    for (int i = 0; i < num_bodies(); ++i) {
      if (bodies_[i].fixed) continue;
      const Vec2d push = push_[i].template cast<double>();
      parameters->force[i] += push;
      parameters->gravity += double(bodies_[i].mass) * push;
    }
  }

  // The Jacobian of one island's step, into work->jacobian. Columns: states, forces, parameters.
  void DifferentiateIsland(std::span<const State> x, const std::vector<int>& island, bool with_parameters,
                           Workspace* work) const {
    const int n = static_cast<int>(island.size());
    work->jacobian.assign(static_cast<size_t>(n) * kSize * Workspace::Columns(n, with_parameters), S(0));
    work->local.assign(num_bodies(), -1);
    for (int i = 0; i < n; ++i) work->local[island[i]] = i;
    CollectCandidates(work);

    const int num_columns = Workspace::Columns(n, with_parameters);
    int first = 0;
    if constexpr (requires { &M::Linearize; }) {
      UsePublishedJacobian(x, island, with_parameters, work);
      first = n * (kSize + 2);
    }
    for (; first < num_columns; first += kJetWidth) DifferentiatePass(x, island, with_parameters, first, work);
  }

  // The touches inside the island, each pair once, in the order of candidates, in island indices.
  void CollectCandidates(Workspace* work) const {
    auto& local = work->island_candidates;
    local.clear();
    for (const Touch& touch : work->touches) {
      const Candidate& c = touch.candidate;
      const bool inside = c.plane ? work->local[c.a] >= 0 : work->local[c.a] >= 0 && work->local[c.b] >= 0;
      if (inside) local.push_back({work->local[c.a], c.plane ? c.b : work->local[c.b], c.plane});
    }
    const auto key = [](const Candidate& c) { return std::tuple(c.plane, c.a, c.b); };
    std::sort(local.begin(), local.end(), [&](const auto& l, const auto& r) { return key(l) < key(r); });
    local.erase(std::unique(local.begin(), local.end()), local.end());
  }

  void DifferentiatePass(std::span<const State> x, const std::vector<int>& island, bool with_parameters, int first,
                         Workspace* work) const {
    const int n = static_cast<int>(island.size());
    const auto seed = [first](S value, int column) {
      Jet jet(value);
      if (column >= first && column < first + kJetWidth) jet.v[column - first] = S(1);
      return jet;
    };
    work->x.resize(n);
    work->next.resize(n);
    work->bodies.resize(n);
    work->jet_force.resize(n);
    const int forces = n * kSize;
    const int parameters = n * (kSize + 2);
    for (int i = 0; i < n; ++i) {
      const int body = island[i];
      for (int j = 0; j < 2; ++j) {
        work->x[i].p[j] = seed(x[body].p[j], i * kSize + j);
        work->x[i].v[j] = seed(x[body].v[j], i * kSize + 2 + j);
        work->jet_force[i][j] = seed(work->force[body][j], forces + 2 * i + j);
      }
      if constexpr (kRotation > 0) {
        for (int j = 0; j < kRotation; ++j) {
          work->x[i].rotation[j] = seed(x[body].rotation[j], i * kSize + 4 + j);
        }
      }
      const BodyConstants<S>& constants = bodies_[body];
      const Jet mass = seed(constants.mass, parameters + 4 + i);
      work->bodies[i] = {mass, constants.fixed ? Jet(S(0)) : Divide(S(1), mass), constants.radius, constants.fixed};
    }
    const StepInput<Jet> in{.h = S(step()),
                            .gravity = scene_.gravity.template cast<S>(),
                            .contact = {seed(contact_.restitution, parameters),
                                        seed(contact_.friction, parameters + 1),
                                        seed(contact_.stiffness, parameters + 2),
                                        seed(contact_.damping, parameters + 3)},
                            .bodies = work->bodies,
                            .planes = planes_,
                            .force = work->jet_force,
                            .candidates = work->island_candidates,
                            .scratch = &work->scratch};
    model_.Step(in, std::span<const JetState>(work->x), std::span<JetState>(work->next));
    work->scratch.release();

    Eigen::Map<Matrix> jacobian = work->Jacobian(n, with_parameters);
    const int width = std::min<int>(kJetWidth, jacobian.cols() - first);
    const Jet* flat = reinterpret_cast<const Jet*>(work->next.data());
    for (int row = 0; row < n * kSize; ++row) {
      jacobian.row(row).segment(first, width) = flat[row].v.head(width).transpose();
    }
  }

  void UsePublishedJacobian(std::span<const State> x, const std::vector<int>& island, bool with_parameters,
                            Workspace* work) const {
    const int n = static_cast<int>(island.size());
    std::vector<State> local(n);
    std::vector<BodyConstants<S>> bodies(n);
    std::vector<Vec2<S>> force(n);
    for (int i = 0; i < n; ++i) {
      local[i] = x[island[i]];
      bodies[i] = bodies_[island[i]];
      force[i] = work->force[island[i]];
    }
    StepInput<S> in = Input(*work);
    in.bodies = bodies;
    in.force = force;
    in.candidates = work->island_candidates;
    Eigen::MatrixXd A, B;
    model_.Linearize(in, std::span<const State>(local), &A, &B);
    Eigen::Map<Matrix> jacobian = work->Jacobian(n, with_parameters);
    jacobian.leftCols(n * kSize) = A.cast<S>();
    jacobian.middleCols(n * kSize, 2 * n) = B.cast<S>();
    work->scratch.release();
  }

  M model_;
  ContactConstants<S> contact_;
  std::vector<BodyConstants<S>> bodies_;
  std::vector<char> fixed_;
  std::vector<HalfPlane<S>> planes_;
  std::vector<HalfPlane<double>> wide_planes_;
  FreeCoefficients free_{};

  std::vector<State> trajectory_;  // (K + 1) x B
  std::vector<S> control_;         // K x C x 2
  std::vector<StepTouch> touches_;
  std::vector<S> lambda_;
  std::vector<Vec2<S>> push_;  // cotangent of the force on each disc in the current step
  Workspace workspace_;
};

}  // namespace saltus
