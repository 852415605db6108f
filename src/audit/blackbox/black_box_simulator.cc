#include "audit/blackbox/black_box_simulator.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "saltus/control/contact_sequence.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/scene_parameter.h"
#include "simulate/islands.h"

namespace saltus {
namespace {

constexpr double kRounding = std::numeric_limits<double>::epsilon();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
// Widths of differences, in the motion of a disc in a step: narrow, so that impacts stay in their steps, but above the
// noise by a factor that the budget of errors gives.
constexpr double kNarrow = 1e-3, kWidest = 0.25, kAboveNoise = 300, kMuchNoise = 1e-11;

using Kind = BlackBoxRequest::Kind;

constexpr double kFelt = 1e3;  // noises by which a velocity must change to be a contact's doing
constexpr double kLeastFelt = 1e-9;

std::string UnsupportedByBlackBox(BlackBox* box, const Scene& scene, int grid_steps) {
  const BlackBoxTraits traits = TraitsFor(box, scene);
  if (!traits.error.empty()) return traits.error;
  if (!traits.not_applicable.empty()) return traits.not_applicable;
  if (scene.steps % grid_steps == 0) return "";
  return "this simulator needs a number of steps divisible by " + std::to_string(grid_steps);
}

}  // namespace

double WidthOfDifferences(double noise, double extent, double moved) {
  return moved * std::clamp(kAboveNoise * std::max(noise, kRounding) * extent / moved, kNarrow, kWidest);
}

BlackBoxRequest BlackBoxSimulator::MakeRequest(Kind kind, int steps) const {
  const std::size_t width = control_width(), all = steps * model_.grid_steps;
  return {kind,
          steps * model_.grid_steps,
          steps * step(),
          initial_,
          {control_.begin(), control_.begin() + std::min(control_.size(), all * width)},
          {}};
}

bool BlackBoxSimulator::Fail(const std::string& why) {
  why_failed_ = why;
  failure_ = RolloutFailure{-1, -1, why_failed_};
  return false;
}

bool BlackBoxSimulator::Rollout(std::span<const double> initial, std::span<const double> control) {
  failure_.reset();
  touches_.clear();
  initial_.assign(initial.begin(), initial.end());
  const std::size_t width = control_width();
  control_.clear();
  for (std::size_t i = 0; i < control.size(); i += std::max<std::size_t>(width, 1)) {
    for (int j = 0; j < model_.grid_steps; ++j) {
      control_.insert(control_.end(), control.begin() + i, control.begin() + i + width);
    }
  }
  BlackBoxAnswer answer = RequestAnswers({MakeRequest(Kind::kSimulate, num_steps_)}).front();
  if (!answer.error.empty()) return Fail(answer.error);
  states_.assign(num_steps_ + 1, {});
  states_.front() = initial_;
  states_.back() = std::move(answer.final);
  if (options_.touches && traits_.step) FindTouches();
  return true;
}

std::vector<double> BlackBoxSimulator::ForceIn(int k) const {
  std::vector<double> force(2 * num_bodies());
  const std::size_t width = control_width();
  if (width > 0) ExpandForce(std::span(control_).subspan(k * model_.grid_steps * width, width), 0, force);
  return force;
}

// Asks for states in between when they are needed: for all at once or by steps, or else as the final state of a shorter
// run.
const std::vector<double>& BlackBoxSimulator::StateAt(int k) const {
  if (!states_[k].empty()) return states_[k];
  const std::vector<double> unknown(state_size(), kNan);
  if (traits_.states) {
    BlackBoxRequest all = MakeRequest(Kind::kSimulate, num_steps_);
    all.states = true;
    const BlackBoxAnswer answer = RequestAnswers({all}).front();
    const std::size_t size = state_size();
    for (int i = 1; i < num_steps_; ++i) {
      const auto at = answer.states.begin() + static_cast<std::ptrdiff_t>(i * size);
      states_[i] = answer.error.empty() ? std::vector<double>(at, at + static_cast<std::ptrdiff_t>(size)) : unknown;
    }
    return states_[k];
  }
  if (traits_.step) {
    for (int i = 0; i + 1 < num_steps_; ++i) {
      states_[i + 1].resize(state_size());
      Step(states_[i], ForceIn(i), states_[i + 1], nullptr);
    }
    return states_[k];
  }
  const BlackBoxAnswer answer = RequestAnswers({MakeRequest(Kind::kSimulate, k)}).front();
  return states_[k] = answer.error.empty() ? answer.final : unknown;
}

void BlackBoxSimulator::GetState(int k, std::span<double> x) const {
  const std::vector<double>& state = StateAt(k);
  std::copy(state.begin(), state.end(), x.begin());
}

void BlackBoxSimulator::ExpandInitial(std::span<const double> initial, std::span<double> x) const {
  std::copy(initial.begin(), initial.end(), x.begin());
  for (int i = 0; i < num_bodies(); ++i) {
    if (scene_.bodies[i].fixed) x[kNumbers * i + 2] = x[kNumbers * i + 3] = 0;
  }
}

void BlackBoxSimulator::AdjointInto(std::span<const double> cotangent, const SensitivityView& out) {
  std::fill(out.initial.begin(), out.initial.end(), 0.0);
  for (std::size_t i = 0; i < out.control.size(); ++i) {
    out.control[i] = i < out.addend.size() ? out.factor * out.addend[i] : 0.0;
  }
  if (out.parameters != nullptr) *out.parameters = {};
  if (!traits_.gradient || options_.differences) return AdjointByDifferences(cotangent, out);
  // The interface has no other way to report a failure: a gradient that is NaN is refused.
  if (!AdjointByItself(cotangent, out)) {
    std::fill(out.initial.begin(), out.initial.end(), kNan);
  }
}

bool BlackBoxSimulator::AdjointByItself(std::span<const double> cotangent, const SensitivityView& out) {
  BlackBoxRequest request = MakeRequest(Kind::kGradient, num_steps_);
  request.final_cotangent.assign(cotangent.begin(), cotangent.end());
  request.parameters = out.parameters != nullptr && !scene_.design.empty();
  const BlackBoxAnswer answer = RequestAnswers({request}).front();
  if (!answer.error.empty()) return false;
  for (std::size_t i = 0; request.parameters && i < scene_.design.size(); ++i) {
    const std::string name = NameOf(scene_.design[i].parameter, scene_);
    const auto given = std::ranges::find(answer.parameters, name, [](const auto& one) { return one.first; });
    if (given == answer.parameters.end()) return false;
    out.parameters->design.push_back(given->second);
  }
  for (std::size_t i = 0; i < out.initial.size(); ++i) {
    out.initial[i] = scene_.bodies[i / kNumbers].fixed ? 0.0 : answer.initial[i];
  }
  const std::size_t width = control_width();
  for (std::size_t i = 0; !out.control.empty() && i < answer.control.size(); ++i) {
    out.control[i / width / model_.grid_steps * width + i % width] += answer.control[i];
  }
  return true;
}

double BlackBoxSimulator::LargestSpeed(std::span<const double> x) const {
  double largest = 0;
  for (int i = 0; i < num_bodies(); ++i) {
    largest = std::max(largest, std::hypot(x[kNumbers * i + 2], x[kNumbers * i + 3]));
  }
  return largest;
}

std::vector<BlackBoxSimulator::Variable> BlackBoxSimulator::Variables(bool with_control) const {
  const double T = scene_.duration;
  double extent = 0, radius = std::numeric_limits<double>::infinity();
  for (int i = 0; i < num_bodies(); ++i) {
    radius = std::min(radius, scene_.bodies[i].radius);
    for (const std::vector<double>* x : {&states_.front(), &states_.back()}) {
      extent = std::max(extent, std::hypot((*x)[kNumbers * i], (*x)[kNumbers * i + 1]));
    }
  }
  const double speed =
      std::max({LargestSpeed(states_.front()), LargestSpeed(states_.back()), kNarrow * radius / step()});
  const double width = Width(speed, extent);
  // Changes of forces act in every step, and vanish there if they are below its rounding: so they are wider.
  const double driven = options_.noise > kMuchNoise ? kWidest * speed * step() : width;
  std::vector<Variable> variables;
  for (int i = 0; i < kNumbers * num_bodies(); ++i) {
    if (!scene_.bodies[i / kNumbers].fixed) {
      variables.push_back({i, false, 0, 0, i % kNumbers < 2 ? width : driven / T});
    }
  }
  const int steps = num_steps_ * model_.grid_steps, segments = std::min(options_.segments, num_steps_);
  for (int s = 0; with_control && s < segments; ++s) {
    for (int i = 0; i < control_width(); ++i) {
      const double mass = scene_.bodies[scene_.control.bodies[i / 2]].mass;
      const auto at = [&](std::int64_t segment) { return static_cast<int>(segment * steps / segments); };
      variables.push_back({i, true, at(s), at(s + 1), segments * 2 * mass * driven / (T * T)});
    }
  }
  return variables;
}

void BlackBoxSimulator::AdjointByDifferences(std::span<const double> cotangent, const SensitivityView& out) {
  const std::vector<Variable> variables = Variables(!out.control.empty());
  const std::size_t pushed = control_width();
  std::vector<BlackBoxRequest> requests;
  for (const Variable& variable : variables) {
    for (const double width : {variable.width, -variable.width}) {
      BlackBoxRequest& request = requests.emplace_back(MakeRequest(Kind::kSimulate, num_steps_));
      if (!variable.control) request.initial[variable.index] += width;
      for (int k = variable.begin; k < variable.end; ++k) request.control[k * pushed + variable.index] += width;
    }
  }
  const std::vector<BlackBoxAnswer> answers = RequestAnswers(requests);
  for (std::size_t v = 0; v < variables.size(); ++v) {
    const Variable& variable = variables[v];
    const BlackBoxAnswer &above = answers[2 * v], &below = answers[2 * v + 1];
    double slope = kNan;
    if (above.error.empty() && below.error.empty()) {
      slope = 0;
      for (std::size_t i = 0; i < cotangent.size(); ++i) slope += cotangent[i] * (above.final[i] - below.final[i]);
      // Rounding makes the actual difference of the two initial states differ from the width.
      const double width = variable.control
                               ? 2 * variable.width
                               : requests[2 * v].initial[variable.index] - requests[2 * v + 1].initial[variable.index];
      slope /= width;
    }
    if (!variable.control) out.initial[variable.index] += slope;
    for (int k = variable.begin; k < variable.end; ++k) {
      out.control[k / model_.grid_steps * pushed + variable.index] += slope / (variable.end - variable.begin);
    }
  }
}

BlackBoxTraits TraitsFor(BlackBox* box, const Scene& scene) {
  BlackBoxTraits traits = box->Describe(scene);
  if (const std::string beyond = NonBallisticFeatures(scene); !beyond.empty()) {
    traits.not_applicable = "the scene has " + beyond + "; black boxes are audited with discs and planes";
  } else if (!scene.materials.empty()) {
    traits.not_applicable = "the scene has materials; black boxes are told one restitution and one friction";
  }
  return traits;
}

Contact MakeBlackBoxContact(std::shared_ptr<BlackBox> box, const BlackBoxTraits& traits,
                            const BlackBoxOptions& options) {
  CHECK_EQ(box->name().find(':'), std::string::npos) << box->name();
  auto entry = std::make_shared<ContactEntry>();
  entry->traits.name = box->name();  // which the functions below keep
  entry->traits.summary = "a black box";
  entry->traits.grid_steps = traits.grid_steps;
  entry->traits.rebound = Rebound::kEmergent;
  entry->reason_not_applicable = [box, steps = traits.grid_steps](const Scene& scene) {
    return UnsupportedByBlackBox(box.get(), scene, steps);
  };
  entry->make = [box, traits, options, model = entry->traits](
                    const Scene& scene, Precision precision, std::span<const OptionValue>) {
    return std::make_unique<BlackBoxSimulator>(box, scene, precision, model, traits, options);
  };
  return Contact(std::move(entry));
}

BlackBoxRequest BlackBoxSimulator::StepFrom(std::span<const double> x, std::span<const double> force) const {
  return {
      BlackBoxRequest::Kind::kStep, model_.grid_steps, step(), {x.begin(), x.end()}, {force.begin(), force.end()}, {}};
}

void BlackBoxSimulator::Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
                             std::vector<Touch>* touches) const {
  const BlackBoxAnswer answer = RequestAnswers({StepFrom(x, force)}).front();
  if (!answer.error.empty()) {
    std::fill(next.begin(), next.end(), kNan);
    return;
  }
  if (touches != nullptr) {
    for (const Touch& touch : TouchesIn(x, force, answer.final)) touches->push_back(touch);
  }
  std::copy(answer.final.begin(), answer.final.end(), next.begin());
}

// Returns the step of the last rollout that begins with state x, if its touches are known; else -1. The search begins
// at the last result, because callers ask for the steps in order.
int BlackBoxSimulator::FindState(std::span<const double> x) const {
  for (int i = 0; options_.touches && i < num_steps_ && !states_.empty(); ++i) {
    const int k = (last_found_ + num_steps_ - i) % num_steps_;
    if (std::equal(x.begin(), x.end(), states_[k].begin(), states_[k].end())) return last_found_ = k;
  }
  return -1;
}

void BlackBoxSimulator::FindTouches() {
  for (int k = 0; k < num_steps_; ++k) {
    for (const Touch& touch : TouchesIn(StateAt(k), ForceIn(k), StateAt(k + 1))) touches_.push_back({k, touch});
  }
}

// Returns the touches of the discs that did not fly freely, each with its nearest neighbour.
std::vector<Touch> BlackBoxSimulator::TouchesIn(std::span<const double> x, std::span<const double> force,
                                                std::span<const double> next) const {
  const double h = step();
  const double speed = std::max(LargestSpeed(x), LargestSpeed(next));
  const double felt = std::max(kLeastFelt, kFelt * options_.noise) * speed;
  const auto vector = [](std::span<const double> of, int at) { return Vec2d(of[at], of[at + 1]); };
  const auto gap = [&](const Candidate& pair) {
    double least = std::numeric_limits<double>::infinity();
    for (const std::span<const double> state : {x, next}) {
      const Vec2d p = vector(state, kNumbers * pair.a);
      const double radius = scene_.bodies[pair.a].radius;
      least = std::min(
          least,
          pair.plane
              ? Dot(Vec2d(scene_.planes[pair.b].normal.normalized()), Vec2d(p - scene_.planes[pair.b].point)) - radius
              : (p - vector(state, kNumbers * pair.b)).norm() - radius - scene_.bodies[pair.b].radius);
    }
    return least;
  };
  std::vector<Candidate> pairs;
  for (int i = 0; i < num_bodies(); ++i) {
    if (scene_.bodies[i].fixed) continue;
    const Vec2d flown =
        vector(x, kNumbers * i + 2) + h * (vector(force, 2 * i) / scene_.bodies[i].mass + scene_.gravity);
    if ((vector(next, kNumbers * i + 2) - flown).norm() <= felt) continue;
    std::optional<Candidate> nearest;
    const auto consider = [&](const Candidate& pair) {
      if (!nearest || gap(pair) < gap(*nearest)) nearest = pair;
    };
    for (int j = 0; j < num_bodies(); ++j) {
      if (j != i) consider({std::min(i, j), std::max(i, j), false});
    }
    for (int j = 0; j < static_cast<int>(scene_.planes.size()); ++j) consider({i, j, true});
    if (nearest && std::find(pairs.begin(), pairs.end(), *nearest) == pairs.end()) pairs.push_back(*nearest);
  }
  std::vector<Touch> touches;
  for (const Candidate& pair : pairs) touches.emplace_back().candidate = pair;
  return touches;
}

std::vector<std::vector<int>> BlackBoxSimulator::IslandsOf(const std::vector<Touch>& touches) const {
  std::vector<Candidate> pairs;
  for (const Touch& touch : touches) pairs.push_back(touch.candidate);
  std::vector<char> fixed;
  for (const Body& body : scene_.bodies) fixed.push_back(body.fixed);
  Islands found;
  found.Find(pairs, fixed);
  std::vector<std::vector<int>> islands;
  for (int q = 0; q < found.size(); ++q) {
    islands.emplace_back();
    for (const int body : found.bodies(q)) {
      if (!fixed[body]) islands.back().push_back(body);
    }
  }
  return islands;
}

void BlackBoxSimulator::Linearize(std::span<const double> x, std::span<const double> force, bool,
                                  StepLinearization* linearization) const {
  if (!free_) free_ = MeasureFreeFlight();
  linearization->body_size = kNumbers;
  linearization->free = *free_;
  linearization->islands.clear();
  linearization->flying.clear();
  linearization->rotation.clear();
  linearization->inverse_mass.assign(num_bodies(), 0.0);
  std::vector<Touch> touches;
  if (const int k = FindState(x); k >= 0) {
    for (const StepTouch& at : touches_) {
      if (at.step == k) touches.push_back(at.touch);
    }
  } else {
    std::vector<double> next(state_size());
    Step(x, force, next, &touches);
  }
  std::vector<char> flies(num_bodies(), 1);
  for (const std::vector<int>& bodies : IslandsOf(touches)) {
    linearization->islands.push_back(LinearizeIsland(x, force, bodies));
    for (const int body : bodies) flies[body] = 0;
  }
  for (int i = 0; i < num_bodies(); ++i) {
    if (!scene_.bodies[i].fixed) linearization->inverse_mass[i] = 1 / scene_.bodies[i].mass;
    if (flies[i] && !scene_.bodies[i].fixed) linearization->flying.push_back(i);
  }
}

StepLinearization::Island BlackBoxSimulator::LinearizeIsland(std::span<const double> x, std::span<const double> force,
                                                             const std::vector<int>& bodies) const {
  const int n = static_cast<int>(bodies.size()), states = kNumbers * n, columns = states + 2 * n;
  double extent = 0;
  for (const double number : x) extent = std::max(extent, std::abs(number));
  const double width = Width(std::max(LargestSpeed(x), kLeastFelt * extent / step()), extent);
  std::vector<BlackBoxRequest> requests;
  std::vector<double> widths;
  for (int c = 0; c < columns; ++c) {
    const bool state = c < states;
    const int body = bodies[state ? c / kNumbers : (c - states) / 2];
    const double by = !state             ? width * scene_.bodies[body].mass / (step() * step())
                      : c % kNumbers < 2 ? width
                                         : width / step();
    widths.push_back(by);
    for (const double w : {by, -by}) {
      BlackBoxRequest& request = requests.emplace_back(StepFrom(x, force));
      if (state) request.initial[kNumbers * body + c % kNumbers] += w;
      if (!state) request.control[2 * body + (c - states) % 2] += w;
    }
  }
  const std::vector<BlackBoxAnswer> answers = RequestAnswers(requests);
  StepLinearization::Island island{bodies, Eigen::MatrixXd(states, states), Eigen::MatrixXd(states, 2 * n), {}};
  for (int c = 0; c < columns; ++c) {
    const BlackBoxAnswer &above = answers[2 * c], &below = answers[2 * c + 1];
    for (int r = 0; r < states; ++r) {
      const int at = kNumbers * bodies[r / kNumbers] + r % kNumbers;
      const bool known = above.error.empty() && below.error.empty();
      const double slope = known ? (above.final[at] - below.final[at]) / (2 * widths[c]) : kNan;
      (c < states ? island.A(r, c) : island.B(r, c - states)) = slope;
    }
  }
  return island;
}

// Measures the free flight of the first moving disc; all discs start at rest. Free flight is linear: any width is good.
StepLinearization::FreeFlight BlackBoxSimulator::MeasureFreeFlight() const {
  std::vector<double> x = InitialState(scene_);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = i % kNumbers < 2 ? x[i] : 0.0;
  const auto moving = std::ranges::find_if(scene_.bodies, [](const Body& body) { return !body.fixed; });
  if (moving == scene_.bodies.end()) return {1, step(), 0, 0, 1, step()};
  const int body = static_cast<int>(moving - scene_.bodies.begin());
  const std::vector<double> none(2 * num_bodies(), 0.0);
  const double small = moving->radius / 64;  // by which it moves, along x
  std::vector<BlackBoxRequest> requests(4, StepFrom(x, none));
  requests[1].initial[kNumbers * body] += small;
  requests[2].initial[kNumbers * body + 2] += small / step();
  requests[3].control[2 * body] += small * moving->mass / (step() * step());
  const std::vector<BlackBoxAnswer> answers = RequestAnswers(requests);
  if (!std::all_of(answers.begin(), answers.end(), [](const BlackBoxAnswer& answer) { return answer.error.empty(); })) {
    return {1, step(), 0, 0, 1, step()};
  }
  const auto by = [&](int request, int entry, double change) {
    return (answers[request].final[kNumbers * body + entry] - answers[0].final[kNumbers * body + entry]) / change;
  };
  const double acceleration = small / (step() * step());
  return {by(1, 0, small),
          by(2, 0, small / step()),
          by(3, 0, acceleration),
          by(1, 2, small),
          by(2, 2, small / step()),
          by(3, 2, acceleration)};
}

}  // namespace saltus
