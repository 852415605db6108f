// Attribution of gradient errors to contacts: the contacts of a rollout as intervals of steps, their costates, the
// error of the linearization over each and its cause, and the part of the error that comes from finite steps.
#include "saltus/audit/attribution.h"

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <memory>
#include <mutex>
#include <numeric>
#include <optional>
#include <utility>

#include "audit/attribution/step_map.h"
#include "base/number_text.h"
#include "base/parallel_for.h"
#include "base/statistics.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/exact_run.h"
#include "scene/units.h"
#include "solve/phases/phase_run.h"

namespace saltus {
namespace {

constexpr double kTouching = 1e-11;  // overlap that is none
constexpr int kMargin = 2;           // steps by which an interval may grow to find the exact impact
// Largest and smallest factor by which steps are refined to find out whether a force is resolved.
constexpr int kFiner = 32, kLeastFiner = 4;
constexpr int kMostFineSteps = 8192;
constexpr int kLongest = 1024;  // steps of one interval; a contact that lasts longer is cut
constexpr double kSmallError = 1e-3;
// In scenes with more discs, costates are pulled back instead of multiplying matrices.
constexpr int kMostDiscsByMatrices = 16;
constexpr std::size_t kKeptNumbers = std::size_t{1} << 23;  // of states

// A pair, with the first and last step in which the model reports a touch of it.
struct PairContact {
  Candidate pair;
  int first = 0, last = 0;

  int steps() const { return last - first + 1; }
};

// Steps [begin, end) of the model, and the pairs that meet in them: connected by discs that move, so that other discs
// may meet in the same steps without being part of it.
struct Interval {
  int begin = 0, end = 0;
  std::vector<PairContact> meetings;

  int first_touch() const { return std::ranges::min(meetings, {}, &PairContact::first).first; }
  int last_touch() const { return std::ranges::max(meetings, {}, &PairContact::last).last; }
  // Returns the number of steps of the longest meeting.
  int longest() const { return std::ranges::max(meetings, {}, &PairContact::steps).steps(); }
};

class Attributor {
 public:
  // Simulates until `stop`, which may be that of AttributionOptions or a limit of time. The others are as there.
  Attributor(const Contact& contact, const Scene& scene, const StopRequest& stop,
             const std::function<void(const std::string&)>& status, int threads)
      : contact_(contact),
        scene_(scene),
        size_(NumbersOfDisc(scene)),
        walls_(WallPartsOf(scene)),
        stop_(stop),
        status_(status),
        threads_(threads),
        model_(Simulate(contact, scene)) {}

  Attribution Run() {
    Attribution out;
    const ModelTraits* exact = ExactModel();
    if (exact != nullptr && ReasonNotApplicable(exact->name, scene_).empty()) exact_contact_ = exact->name;
    if (exact_contact_.empty()) {
      out.reason = "there is no exact flow";
      return out;
    }
    if (const std::string beyond = NonBallisticForces(scene_); !beyond.empty()) {
      out.reason = "the scene has " + beyond + "; contacts are compared between flights of constant acceleration";
      return out;
    }
    initial_ = InitialState(scene_);
    control_ = InitialControl(scene_, model_->num_steps());
    if (!model_->Rollout(initial_, control_)) {
      if (model_->stopped()) {
        out.limit = "no contacts";
        return out;
      }
      out.reason = "the rollout fails: " + model_->FailureReason();
      return out;
    }
    const std::vector<Interval> intervals = FindIntervals();
    if (!model_->stopped()) FindCostates(intervals);
    if (!model_->stopped()) out.contacts = CompareAll(intervals);
    if (out.contacts.size() == intervals.size()) {
      out.sequence = CompareSequences(intervals);
    } else {
      out.limit = std::to_string(out.contacts.size()) + " of " + std::to_string(intervals.size()) + " contacts";
    }
    return out;
  }

 private:
  const Simulator& model() const { return *model_; }
  double h() const { return model_->step(); }
  std::unique_ptr<Simulator> Simulate(const Contact& contact, const Scene& scene) const {
    std::unique_ptr<Simulator> simulator = MakeSimulator(contact, scene, Precision::kDouble);
    simulator->set_stop(stop_);
    return simulator;
  }

  // Returns a state of the rollout. The last ones are kept; a query may simulate again, so only one thread may ask.
  std::vector<double> StateAt(int k) const {
    const std::lock_guard lock(looking_back_);
    if (const auto known = states_.find(k); known != states_.end()) return known->second;
    if (states_.size() >= kKeptNumbers / model_->state_size()) states_.clear();
    std::vector<double>& x = states_[k];
    x.resize(model_->state_size());
    model_->GetState(k, x);
    return x;
  }
  // Returns a state without rotation that only the model has.
  std::vector<double> PlainStateAt(int k) const {
    std::vector<double> x = StateAt(k);
    if (model_->body_size() == size_) return x;
    std::vector<double> plain;
    for (int i = 0; i < model_->num_bodies(); ++i) {
      plain.insert(plain.end(), x.begin() + i * model_->body_size(), x.begin() + i * model_->body_size() + size_);
    }
    return plain;
  }
  ForceOfStep IntervalForces(int begin, int finer = 1) const {
    return [this, begin, finer](int k, std::span<double> force) {
      model_->ExpandForce(control_, begin + k / finer, force);
    };
  }
  // Returns the scene for the model `contact` over the time of an interval, cut into `steps` of the model's steps.
  Scene IntervalScene(const Contact& contact, const Interval& interval, int steps) const {
    Scene scene = scene_;
    scene.duration = (interval.end - interval.begin) * h();
    scene.steps = steps * CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
    return scene;
  }
  std::unique_ptr<Simulator> SimulatorOf(const Contact& contact, const Interval& interval, int steps) const {
    return Simulate(contact, IntervalScene(contact, interval, steps));
  }

  std::vector<Interval> FindIntervals() const {
    std::vector<Interval> intervals;
    for (const StepTouch& at : model_->touches()) {
      AddTouch(at, &intervals);
      if (intervals.size() > Attribution::kMostContacts) {
        intervals.pop_back();
        break;
      }
    }
    std::ranges::stable_sort(intervals,
                             [](const Interval& a, const Interval& b) { return a.first_touch() < b.first_touch(); });
    for (size_t i = 0; i < intervals.size(); ++i) {
      Interval& interval = intervals[i];
      // The interval may grow up to its neighbours in time that share a disc.
      int from = 0, to = model_->num_steps();
      for (size_t j = 0; j < intervals.size(); ++j) {
        const bool shares = std::ranges::any_of(
            intervals[j].meetings, [&](const PairContact& meeting) { return Involves(interval, meeting.pair); });
        if (j == i || !shares) continue;
        if (j < i) from = std::max(from, intervals[j].end);
        if (j > i) to = std::min(to, intervals[j].begin);
      }
      const auto full = [&] { return interval.end - interval.begin >= kLongest; };
      while (interval.begin > from && !full() && Overlap(interval, interval.begin)) --interval.begin;
      for (int margin = 0; margin < kMargin && !full() && !HasExactImpact(interval); ++margin) {
        if (interval.begin > from) --interval.begin;
        if (interval.end < to) ++interval.end;
      }
    }
    return intervals;
  }

  void AddTouch(const StepTouch& at, std::vector<Interval>* intervals) const {
    const auto belongs = [&](const Interval& interval) {
      return at.step <= interval.end && at.step - interval.begin < kLongest && Involves(interval, at.touch.candidate);
    };
    Interval joined{at.step, at.step + 1, {{at.touch.candidate, at.step, at.step}}};
    for (const Interval& interval : *intervals) {
      if (!belongs(interval)) continue;
      joined.begin = std::min(joined.begin, interval.begin);
      joined.end = std::max(joined.end, interval.end);
      for (const PairContact& meeting : interval.meetings) {
        if (meeting.pair == at.touch.candidate) {
          joined.meetings.front().first = std::min(meeting.first, joined.meetings.front().first);
        } else {
          joined.meetings.push_back(meeting);
        }
      }
    }
    std::erase_if(*intervals, belongs);
    while (joined.end < model_->num_steps() && joined.end - joined.begin < kLongest && Overlap(joined, joined.end)) {
      ++joined.end;
    }
    intervals->push_back(std::move(joined));
  }

  bool Overlap(const Interval& interval, int k) const {
    const std::vector<double> x = PlainStateAt(k);
    const auto position = [&](int i) { return Vec2d(x[size_ * i], x[size_ * i + 1]); };
    return std::any_of(interval.meetings.begin(), interval.meetings.end(), [&](const PairContact& meeting) {
      const Candidate& pair = meeting.pair;
      const double radius = scene_.bodies[pair.a].radius;
      if (pair.plane) {
        return Separate<double>(position(pair.a), walls_[pair.b].wall).distance < radius - kTouching;
      }
      return (position(pair.a) - position(pair.b)).norm() < radius + scene_.bodies[pair.b].radius - kTouching;
    });
  }

  bool Involves(const Interval& interval, const Candidate& pair) const {
    const auto shares = [&](int body, const Candidate& other) {
      return !scene_.bodies[body].fixed && (body == other.a || (!other.plane && body == other.b));
    };
    return std::any_of(interval.meetings.begin(), interval.meetings.end(), [&](const PairContact& meeting) {
      return shares(pair.a, meeting.pair) || (!pair.plane && shares(pair.b, meeting.pair));
    });
  }

  bool HasExactImpact(const Interval& interval) const {
    const std::vector<StepTouch> touches = ExactTouches(interval);
    return std::ranges::any_of(touches, [&](const StepTouch& at) { return Involves(interval, at.touch.candidate); });
  }

  StepMap ExactMap(const Interval& interval, const std::vector<int>* bodies) const {
    if (bodies != nullptr && HasManyDiscs()) return IntervalMap(exact_contact_, interval, 1, *bodies);
    const int steps = interval.end - interval.begin;
    const std::unique_ptr<Simulator> exact = SimulatorOf(exact_contact_, interval, steps);
    const std::vector<double> begin = PlainStateAt(interval.begin);
    return RunSteps(*exact, begin, IntervalForces(interval.begin), steps, bodies);
  }

  std::vector<StepTouch> IntervalTouches(const Contact& contact, const Interval& interval) const {
    const std::unique_ptr<Simulator> simulator = SimulatorOf(contact, interval, interval.end - interval.begin);
    simulator->Rollout(ToInitial(PlainStateAt(interval.begin), scene_.num_bodies()),
                       InitialControl(simulator->scene(), simulator->num_steps()));
    return simulator->touches();
  }

  std::vector<StepTouch> ExactTouches(const Interval& interval) const {
    return HasManyDiscs() ? IntervalTouches(exact_contact_, interval) : ExactMap(interval, nullptr).touches;
  }

  std::vector<StepTouch> ModelTouches(const Interval& interval) const {
    if (HasManyDiscs()) return IntervalTouches(contact_, interval);
    const int steps = interval.end - interval.begin;
    return RunSteps(model(), StateAt(interval.begin), IntervalForces(interval.begin), steps, nullptr).touches;
  }

  // Returns the linearization of the model over some discs, with `finer` times as many steps.
  StepMap ModelMap(const Interval& interval, const std::vector<int>& bodies, int finer = 1) const {
    if (HasManyDiscs()) return IntervalMap(contact_, interval, finer, bodies);
    const int steps = (interval.end - interval.begin) * finer;
    std::unique_ptr<Simulator> fine;
    if (finer > 1) fine = SimulatorOf(contact_, interval, steps);
    const Simulator& simulator = finer > 1 ? *fine : model();
    return RunSteps(simulator, StateAt(interval.begin), IntervalForces(interval.begin, finer), steps, &bodies);
  }

  // Returns the linearization over discs that meet no others in the interval; among many discs these are simulated
  // alone.
  StepMap IntervalMap(const Contact& contact, const Interval& interval, int finer,
                      const std::vector<int>& bodies) const {
    const int steps = (interval.end - interval.begin) * finer;
    Scene scene = IntervalScene(contact, interval, steps);
    scene.control = {};
    scene.objective.terminal.clear();
    scene.free.clear();
    scene.free_spin.clear();
    scene.bodies.clear();
    std::vector<int> local;
    const std::vector<double> begin_state = PlainStateAt(interval.begin);
    std::vector<double> moves, turns;
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      const bool wanted = std::binary_search(bodies.begin(), bodies.end(), i);
      if (!wanted && !scene_.bodies[i].fixed) continue;
      const int at = scene.num_bodies();
      if (wanted) local.push_back(at);
      scene.bodies.push_back(scene_.bodies[i]);
      const auto state = begin_state.begin() + size_ * i;
      moves.insert(moves.end(), state, state + 4);
      turns.insert(turns.end(), state + 4, state + size_);
      for (int c = 0; c < scene_.num_controlled(); ++c) {
        if (scene_.control.bodies[c] != i) continue;
        scene.control.bodies.push_back(at);
        scene.control.initial.push_back(scene_.control.initial[c]);
      }
      for (int t = 0; t < scene_.num_torques(); ++t) {
        if (scene_.control.torque_bodies[t] != i) continue;
        scene.control.torque_bodies.push_back(at);
        scene.control.initial_torque.push_back(scene_.control.initial_torque[t]);
      }
    }
    const std::unique_ptr<Simulator> simulator = Simulate(contact, scene);
    const std::vector<double> control = InitialControl(scene, simulator->num_steps());
    const auto force = [&](int k, std::span<double> f) { simulator->ExpandForce(control, k, f); };
    if (scene.Spins()) moves.insert(moves.end(), turns.begin(), turns.end());
    std::vector<double> begin(simulator->state_size());
    simulator->ExpandInitial(moves, begin);
    StepMap map = RunSteps(*simulator, begin, force, steps, &local);
    if (NumbersOfDisc(scene) == size_) return map;
    // None of these discs spins, so their angles are linear in time, as in the whole scene.
    const int n = static_cast<int>(local.size());
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(size_ * n, size_ * n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) A.block<4, 4>(size_ * i, size_ * j) = map.A.block<4, 4>(4 * i, 4 * j);
      A.block<2, 2>(size_ * i + 4, size_ * i + 4) << 1, scene.duration, 0, 1;
    }
    map.A = std::move(A);
    return map;
  }

  // Finds the costates by one sweep of the model's adjoint from the final time.
  void FindCostates(const std::vector<Interval>& intervals) {
    std::vector<double> lambda(model_->state_size()), before(lambda.size()), u(model_->force_size());
    std::vector<double> unused(u.size());
    TerminalGradient(scene_.objective, StateAt(model_->num_steps()), model_->body_size(), lambda);
    costates_.resize(intervals.size());
    std::vector<size_t> order(intervals.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return intervals[a].end > intervals[b].end; });
    StepLinearization step;
    int k = model_->num_steps();
    for (size_t i : order) {
      if (HasManyDiscs() && k > intervals[i].end) {
        const Eigen::VectorXd pulled =
            PullBackInterval(intervals[i].end, k, Eigen::Map<Eigen::VectorXd>(lambda.data(), lambda.size()));
        lambda.assign(pulled.begin(), pulled.end());
        k = intervals[i].end;
      }
      for (; k > intervals[i].end; --k) {
        model_->ExpandForce(control_, k - 1, u);
        model_->Linearize(StateAt(k - 1), u, /*with_parameters=*/false, &step);
        step.ApplyTranspose(lambda, before, unused);
        std::swap(lambda, before);
      }
      costates_[i] = Eigen::Map<Eigen::VectorXd>(lambda.data(), lambda.size());
    }
  }

  bool HasManyDiscs() const { return scene_.num_bodies() > kMostDiscsByMatrices && model_->body_size() == size_; }

  Eigen::VectorXd PullBackInterval(int begin, int end, const Eigen::VectorXd& costate) const {
    std::vector<int> all(model_->num_bodies());
    std::iota(all.begin(), all.end(), 0);
    return PullBackInterval(contact_, {begin, end, {}}, 1, all, costate).Sum();
  }

  PulledCostate PullBackInterval(const Contact& contact, const Interval& interval, int finer,
                                 const std::vector<int>& bodies, const Eigen::VectorXd& lambda) const {
    const std::unique_ptr<Simulator> simulator =
        SimulatorOf(contact, interval, (interval.end - interval.begin) * finer);
    return PullBackCostate(simulator.get(), PlainStateAt(interval.begin), bodies, lambda);
  }

  // Compares linearizations by their products with the costate, which is all of them that enters the gradient.
  void CompareByProducts(const Interval& interval, const std::vector<int>& bodies, const Eigen::VectorXd& lambda,
                         const std::vector<StepTouch>& exact, ContactError* error) const {
    const PulledCostate right = PullBackInterval(exact_contact_, interval, 1, bodies, lambda);
    const PulledCostate own = PullBackInterval(contact_, interval, 1, bodies, lambda);
    const double size = Norm(own.Sum() - right.Sum(), bodies), scale = std::max(Norm(right.Sum(), bodies), 1e-300);
    error->error = size / scale;
    error->block = LargestBlock([&](bool to_velocity, bool from_velocity) {
      Eigen::VectorXd part =
          to_velocity ? own.by_velocities - right.by_velocities : own.by_positions - right.by_positions;
      for (int c = 0; c < part.size(); ++c) {
        if (IsRate(c % size_) != from_velocity) part[c] = 0;
      }
      return Norm(part, bodies);
    });
    if (error->error <= kSmallError) return;
    if (const std::string plain = CauseFromTouches(interval, exact); !plain.empty()) {
      error->cause = plain;
    } else if (interval.longest() > 1) {
      const PulledCostate fine = PullBackInterval(contact_, interval, FinerSteps(interval), bodies, lambda);
      error->cause = DescribeUnresolved(interval, size, Norm(fine.Sum() - right.Sum(), bodies));
    } else {
      error->cause = CauseInOneStep(exact);
    }
  }

  static Block LargestBlock(const std::function<double(bool to_velocity, bool from_velocity)>& size) {
    Block largest_block = Block::kPositionFromPosition;
    double largest = -1;
    for (const Block block : {Block::kPositionFromPosition,
                              Block::kVelocityFromPosition,
                              Block::kPositionFromVelocity,
                              Block::kVelocityFromVelocity}) {
      const bool to_velocity = block == Block::kVelocityFromPosition || block == Block::kVelocityFromVelocity;
      const bool from_velocity = block == Block::kPositionFromVelocity || block == Block::kVelocityFromVelocity;
      const double here = size(to_velocity, from_velocity);
      if (here <= largest) continue;
      largest = here;
      largest_block = block;
    }
    return largest_block;
  }

  ContactError Compare(const Interval& interval, const Eigen::VectorXd& costate) const {
    ContactError error;
    error.first_step = interval.first_touch();
    error.last_step = interval.last_touch();
    const auto first = std::ranges::find_if(
        interval.meetings, [&](const PairContact& meeting) { return meeting.first == error.first_step; });
    error.pair = first->pair;
    error.a = scene_.bodies[first->pair.a].name;
    error.b = first->pair.plane ? walls_[first->pair.b].name : scene_.bodies[first->pair.b].name;

    std::vector<StepTouch> own = ModelTouches(interval);
    std::vector<StepTouch> exact_touches = ExactTouches(interval);
    std::vector<int> bodies;
    KeepConnected(interval, &exact_touches, &own, &bodies);
    const int n = static_cast<int>(bodies.size());
    Eigen::VectorXd lambda(size_ * n);
    for (int i = 0; i < n; ++i) {
      lambda.segment(size_ * i, size_) = costate.segment(bodies[i] * model().body_size(), size_);
    }
    error.exact_impacts = static_cast<int>(exact_touches.size());
    if (HasManyDiscs() && n > kMostDiscsByMatrices) {
      CompareByProducts(interval, bodies, lambda, exact_touches, &error);
      return error;
    }
    StepMap exact = ExactMap(interval, &bodies);
    exact.touches = exact_touches;
    const StepMap approximate = ModelMap(interval, bodies);
    const Eigen::MatrixXd difference = approximate.A - exact.A;
    const double scale = std::max(Norm(exact.A.transpose() * lambda, bodies), 1e-300);
    error.error = Norm(difference.transpose() * lambda, bodies) / scale;
    error.block = LargestBlock([&](bool to_velocity, bool from_velocity) {
      Eigen::VectorXd part = Eigen::VectorXd::Zero(size_ * n);
      for (int r = 0; r < size_ * n; ++r) {
        if (IsRate(r % size_) != to_velocity) continue;
        for (int c = 0; c < size_ * n; ++c) {
          if (IsRate(c % size_) == from_velocity) part[c] += difference(r, c) * lambda[r];
        }
      }
      return Norm(part, bodies);
    });
    if (error.error > kSmallError) error.cause = FindCause(interval, exact, approximate, bodies);
    return error;
  }

  std::string FindCause(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                        const std::vector<int>& bodies) const {
    if (const std::string plain = CauseFromTouches(interval, exact.touches); !plain.empty()) return plain;
    if (interval.longest() > 1) return CauseOfUnresolvedForce(interval, exact, approximate, bodies);
    if (const std::optional<PairImpact> impact = IsSingleImpact(interval, exact)) {
      // Bodies are in the order of their indices, and so are the two of a pair.
      if (const std::optional<std::string> fault = RecogniseFault(*impact, approximate.A, scene_.duration))
        return *fault;
    }
    return CauseInOneStep(exact.touches);
  }

  // Returns the cause that follows from the touches alone; empty if none does.
  static std::string CauseFromTouches(const Interval& interval, const std::vector<StepTouch>& exact) {
    if (exact.empty()) return "touches where the exact motion does not";
    const bool rests = std::any_of(
        exact.begin(), exact.end(), [](const StepTouch& at) { return at.touch.kind == ContactKind::kSustained; });
    return rests || interval.end - interval.begin >= kLongest ? "a contact that lasts" : "";
  }

  static std::string CauseInOneStep(const std::vector<StepTouch>& exact) {
    return exact.size() > 1 ? std::to_string(exact.size()) + " impacts in one step" : "no known cause";
  }

  std::optional<PairImpact> IsSingleImpact(const Interval& interval, const StepMap& exact) const {
    if (exact.touches.size() != 1 || interval.meetings.size() != 1) return std::nullopt;
    const StepTouch& at = exact.touches.front();
    const Candidate& pair = at.touch.candidate;
    if (at.touch.kind != ContactKind::kImpact || !(pair == interval.meetings.front().pair)) return std::nullopt;

    // The exact state at the begin of the step with the impact, and from there to the impact.
    Interval until = interval;
    until.end = interval.begin + at.step;
    std::vector<double> x = PlainStateAt(interval.begin);
    if (at.step > 0) x = ExactMap(until, nullptr).end;
    std::vector<double> force(model_->force_size());
    IntervalForces(interval.begin)(at.step, force);
    const double time = at.touch.time;
    struct Motion {
      Vec2d p, v, a;
      double inverse_mass;
    };
    const auto motion = [&](int i) -> Motion {
      const Body& body = scene_.bodies[i];
      const double* disc = &x[size_ * i];
      const Vec2d p(disc[0], disc[1]), v(disc[2], disc[3]);
      if (body.fixed) return {p, Vec2d::Zero(), Vec2d::Zero(), 0.0};
      const Vec2d a = Vec2d(force[2 * i], force[2 * i + 1]) / body.mass + scene_.gravity;
      return {p + time * (v + 0.5 * time * a), v + time * a, a, 1 / body.mass};
    };
    const Motion a = motion(pair.a);
    PairImpact impact;
    impact.inverse_mass_a = a.inverse_mass;
    impact.velocity_a = a.v;
    impact.acceleration_a = a.a;
    impact.velocity_b = impact.acceleration_b = Vec2d::Zero();
    if (pair.plane) {
      const Wall<double>& wall = walls_[pair.b].wall;
      const Separation<double> at_wall = Separate<double>(a.p, wall);
      impact.normal = at_wall.normal;
      if (wall.curved()) impact.inverse_distance = 1 / (at_wall.distance + wall.side * wall.radius);
    } else {
      const Motion b = motion(pair.b);
      impact.normal = (a.p - b.p).normalized();
      impact.inverse_distance = 1 / (a.p - b.p).norm();
      impact.inverse_mass_b = b.inverse_mass;
      impact.velocity_b = b.v;
      impact.acceleration_b = b.a;
    }
    for (int side = 0; side < (pair.plane ? 1 : 2); ++side) {
      const int i = side == 0 ? pair.a : pair.b;
      const Body& body = scene_.bodies[i];
      impact.radius[side] = body.radius;
      if (!body.Spins()) continue;
      impact.inverse_inertia[side] = 1 / body.MomentOfInertia();
      impact.spin[side] = x[size_ * i + 5];
      if (scene_.num_torques() == 0) continue;
      const double torque = body.radius * force[2 * scene_.bodies.size() + i];
      impact.spin[side] += time * torque * impact.inverse_inertia[side];
    }
    impact.spins = scene_.Spins();
    const int other = pair.plane ? walls_[pair.b].wall.material - 1 : scene_.bodies[pair.b].material;
    const auto contact = ContactBetween(scene_, scene_.bodies[pair.a].material, other);
    impact.restitution = contact.restitution;
    impact.friction = contact.friction;
    impact.mode = at.touch.mode;
    impact.before = at.step * h() + time;
    impact.after = (interval.end - interval.begin) * h() - impact.before;
    impact.step = h();
    return impact;
  }

  // Returns whether the cause is an unresolved force, by the same model over the interval with far smaller steps.
  std::string CauseOfUnresolvedForce(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                                     const std::vector<int>& bodies) const {
    const StepMap fine = ModelMap(interval, bodies, FinerSteps(interval));
    const Eigen::VectorXd scales = StateScales(scene_, bodies, scene_.duration);
    const double coarse_error = ScaledNorm(approximate.A - exact.A, scales);
    const double fine_error = ScaledNorm(fine.A - exact.A, scales);
    return DescribeUnresolved(interval, coarse_error, fine_error);
  }

  // Returns the factor by which the steps of an interval are refined to see if its forces are resolved.
  int FinerSteps(const Interval& interval) const {
    return std::clamp(kMostFineSteps / (interval.end - interval.begin), kLeastFiner, kFiner);
  }

  std::string DescribeUnresolved(const Interval& interval, double coarse_error, double fine_error) const {
    const int lasts = interval.longest();
    if (!(fine_error < 0.5 * coarse_error)) {
      return "contact is soft: it lasts " + ToText(lasts * h() * scene_.units.time, 2) +
             " s, and smaller steps do not help";
    }
    return FormatNumbers("contact force not resolved by its %.0f steps (%.0f times as many leave %.0f %% of the error)",
                         lasts,
                         FinerSteps(interval),
                         100 * fine_error / coarse_error);
  }

  // Drops touches that no chain of touches connects with the interval; collects the moving discs of the others.
  void KeepConnected(Interval interval, std::vector<StepTouch>* exact, std::vector<StepTouch>* own,
                     std::vector<int>* bodies) const {
    const auto involved = [&](const StepTouch& at) { return Involves(interval, at.touch.candidate); };
    for (bool grown = true; grown;) {
      grown = false;
      for (const std::vector<StepTouch>* touches : {exact, own}) {
        for (const StepTouch& at : *touches) {
          const bool known = std::ranges::any_of(
              interval.meetings, [&](const PairContact& meeting) { return meeting.pair == at.touch.candidate; });
          if (known || !involved(at)) continue;
          interval.meetings.push_back({at.touch.candidate, at.step, at.step});
          grown = true;
        }
      }
    }
    std::erase_if(*exact, std::not_fn(involved));
    std::erase_if(*own, std::not_fn(involved));
    for (const PairContact& meeting : interval.meetings) {
      bodies->push_back(meeting.pair.a);
      if (!meeting.pair.plane) bodies->push_back(meeting.pair.b);
    }
    std::sort(bodies->begin(), bodies->end());
    bodies->erase(std::unique(bodies->begin(), bodies->end()), bodies->end());
    std::erase_if(*bodies, [&](int body) { return scene_.bodies[body].fixed; });
  }

  double Norm(const Eigen::VectorXd& costate, const std::vector<int>& bodies) const {
    const Eigen::VectorXd scales = StateScales(scene_, bodies, scene_.duration);
    const Eigen::VectorXd scaled = costate.cwiseQuotient(scales);
    return saltus::Norm({scaled.begin(), scaled.end()});
  }

  std::string PairName(const Candidate& pair) const {
    return scene_.bodies[pair.a].name + " - " + (pair.plane ? walls_[pair.b].name : scene_.bodies[pair.b].name);
  }

  // Compares how often each pair meets; a contact counts once as long as it lasts. The order is not compared, as
  // several contacts may be in one step.
  std::string CompareSequences(const std::vector<Interval>& intervals) const {
    if (intervals.size() >= Attribution::kMostContacts) return "";
    std::vector<std::string> pairs;  // in the order of their first exact contact, then of the model's
    std::map<std::string, int> own, exact;
    const auto count = [&](const Candidate& pair, std::map<std::string, int>* counts) {
      const std::string name = PairName(pair);
      if (own[name] + exact[name] == 0) pairs.push_back(name);
      ++(*counts)[name];
    };
    const std::unique_ptr<Simulator> reference = Simulate(exact_contact_, scene_);
    if (!reference->Rollout(initial_, InitialControl(scene_, reference->num_steps()))) return "";
    for (const StepTouch& at : reference->touches()) {
      if (at.touch.kind == ContactKind::kImpact) count(at.touch.candidate, &exact);
    }
    for (const Interval& interval : intervals) {
      for (const PairContact& meeting : interval.meetings) count(meeting.pair, &own);
    }
    for (const std::string& pair : pairs) {
      if (own[pair] == exact[pair]) continue;
      return pair + " meet " + std::to_string(own[pair]) + " times, not " + std::to_string(exact[pair]);
    }
    return "";
  }

  // Returns the errors of all contacts, of the first ones if it is stopped: they are begun in order, so few are lost.
  std::vector<ContactError> CompareAll(const std::vector<Interval>& intervals) const {
    std::vector<std::optional<ContactError>> found(intervals.size());
    std::atomic<std::size_t> next = 0;
    std::mutex saying;
    ParallelFor(threads_, threads_, [&](int, int) {
      for (std::size_t i = next++; i < intervals.size() && !model_->stopped(); i = next++) {
        if (status_) {
          const std::lock_guard lock(saying);
          status_("contact " + std::to_string(i + 1) + " of " + std::to_string(intervals.size()) + " at " +
                  std::to_string(model_->num_steps()) + " steps");
        }
        ContactError error = Compare(intervals[i], costates_[i]);
        if (!model_->stopped()) found[i] = std::move(error);
      }
    });
    std::vector<ContactError> errors;
    for (std::size_t i = 0; i < found.size() && found[i]; ++i) errors.push_back(std::move(*found[i]));
    return errors;
  }

  Contact contact_;
  Scene scene_;
  int size_;  // numbers of a disc
  std::vector<WallPart> walls_;
  const StopRequest stop_;
  const std::function<void(const std::string&)> status_;
  const int threads_;
  std::unique_ptr<Simulator> model_;
  std::string exact_contact_;
  std::vector<double> initial_, control_;
  std::vector<Eigen::VectorXd> costates_;  // at the end of each interval
  mutable std::mutex looking_back_;
  mutable std::map<int, std::vector<double>> states_;  // by step
};

// An error stays if a refinement leaves more than kStays of it. Steps are refined at least eightfold, by which an error
// of first order falls to an eighth, and to about as many steps as make causes clear.
constexpr int kRefinement = 8, kMostRefinement = 256;
constexpr int kClearSteps = 2000;
constexpr double kStays = 0.25;

}  // namespace

const char* BlockToString(Block block) {
  constexpr const char* kNames[] = {
      "position from position", "velocity from position", "position from velocity", "velocity from velocity"};
  return kNames[static_cast<int>(block)];
}

Attribution AttributeError(const Contact& contact, const Scene& given, const AttributionOptions& options) {
  CHECK_GE(options.seconds, 0);
  CHECK_GT(options.threads, 0);
  Attribution refused;
  refused.reason = ReasonNotApplicable(contact, given);
  if (!refused.ok()) return refused;
  const Scene scene = ToNaturalUnits(given);
  const StopRequest end = StopAfter(options.seconds, options.stop);
  const StopRequest half = StopAfter(options.seconds / 2, options.stop);
  Attribution own = Attributor(contact, scene, half, options.status, options.threads).Run();
  const std::string after = " compared in " + ToText(options.seconds, 3) + " s";
  if (!own.limit.empty()) own.limit += after;
  if (!own.ok() || own.contacts.empty()) return own;
  // The number of steps is no exact multiple, so that an impact on a grid node is not on a node of the refined grid.
  Scene refined = scene;
  refined.steps = std::clamp(kClearSteps / scene.steps, kRefinement, kMostRefinement) * scene.steps +
                  CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  const Attribution fine = Attributor(contact, refined, end, options.status, options.threads).Run();
  if (!fine.limit.empty()) {
    own.limit += (own.limit.empty() ? "" : "; ") + fine.limit + " with more steps" + after;
  }
  for (size_t i = 0; i < own.contacts.size(); ++i) {
    ContactError& error = own.contacts[i];
    const ContactError* same = i < fine.contacts.size() ? &fine.contacts[i] : nullptr;
    if (same != nullptr && (same->a != error.a || same->b != error.b)) same = nullptr;
    const bool cut = same == nullptr && !fine.limit.empty();  // then the steps may be to blame, or not
    error.stays = error.error > kSmallError && !cut && (same == nullptr || same->error > kStays * error.error);
    // An impulse, whose closed form is that of a point in time, is judged by the smallest steps; a force that acts for
    // a while by the scene's own.
    const ContactError& finest = same != nullptr ? *same : error;
    const bool impulse = finest.first_step == finest.last_step;
    if (impulse && !finest.cause.empty()) error.cause = finest.cause;
    if (!impulse && error.first_step == error.last_step) error.cause = "contact force not resolved by its single step";
    if (!error.stays && impulse) error.cause.clear();
    if (own.first_wrong < 0 && error.error > kSmallError && (error.stays || !impulse)) {
      own.first_wrong = static_cast<int>(i);
    }
  }
  return own;
}

}  // namespace saltus
