// Steps of a black box that gives them: what touches in one, and its linearization by differences.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "audit/blackbox/black_box_simulator.h"
#include "saltus/scene/geometry.h"

namespace saltus {
namespace {

constexpr double kFelt = 1e3;  // noises by which a velocity must change to be a contact's doing
constexpr double kLeastFelt = 1e-9;

}  // namespace

Question BlackBoxSimulator::StepFrom(std::span<const double> x, std::span<const double> force) const {
  return {Question::Kind::kStep, model_.grid_steps, step(), {x.begin(), x.end()}, {force.begin(), force.end()}, {}};
}

void BlackBoxSimulator::Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
                             std::vector<Touch>* touches) const {
  const Answer answer = AnswersTo({StepFrom(x, force)}).front();
  if (!answer.error.empty()) {
    std::fill(next.begin(), next.end(), std::numeric_limits<double>::quiet_NaN());
    return;
  }
  if (touches != nullptr) {
    for (const Touch& touch : TouchesIn(x, force, answer.final)) touches->push_back(touch);
  }
  std::copy(answer.final.begin(), answer.final.end(), next.begin());
}

// Of the last rollout, if what touches in it is known: the step from a state; else -1. Who asks goes through them in
// order.
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

// Discs that did not fly freely, with what is nearest to each.
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
  for (const Candidate& pair : pairs) {
    Touch& touch = touches.emplace_back();
    touch.candidate = pair;
  }
  return touches;
}

std::vector<std::vector<int>> BlackBoxSimulator::IslandsOf(const std::vector<Touch>& touches) const {
  std::vector<int> label(num_bodies());
  std::iota(label.begin(), label.end(), 0);
  std::vector<char> touched(num_bodies(), 0);
  for (const Touch& touch : touches) {
    const Candidate& pair = touch.candidate;
    touched[pair.a] = 1;
    if (pair.plane) continue;
    touched[pair.b] = 1;
    if (!scene_.bodies[pair.a].fixed && !scene_.bodies[pair.b].fixed) {
      std::replace(label.begin(), label.end(), label[pair.b], label[pair.a]);
    }
  }
  std::vector<std::vector<int>> islands;
  for (int i = 0; i < num_bodies(); ++i) {
    std::vector<int> bodies;
    for (int j = 0; j < num_bodies(); ++j) {
      if (touched[j] && !scene_.bodies[j].fixed && label[j] == i) bodies.push_back(j);
    }
    if (!bodies.empty()) islands.push_back(std::move(bodies));
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
  std::vector<Question> questions;
  std::vector<double> widths;
  for (int c = 0; c < columns; ++c) {
    const bool state = c < states;
    const int body = bodies[state ? c / kNumbers : (c - states) / 2];
    const double by = !state             ? width * scene_.bodies[body].mass / (step() * step())
                      : c % kNumbers < 2 ? width
                                         : width / step();
    widths.push_back(by);
    for (const double w : {by, -by}) {
      Question& question = questions.emplace_back(StepFrom(x, force));
      if (state) question.initial[kNumbers * body + c % kNumbers] += w;
      if (!state) question.control[2 * body + (c - states) % 2] += w;
    }
  }
  const std::vector<Answer> answers = AnswersTo(questions);
  StepLinearization::Island island{bodies, Eigen::MatrixXd(states, states), Eigen::MatrixXd(states, 2 * n), {}};
  for (int c = 0; c < columns; ++c) {
    const Answer &above = answers[2 * c], &below = answers[2 * c + 1];
    for (int r = 0; r < states; ++r) {
      const int at = kNumbers * bodies[r / kNumbers] + r % kNumbers;
      const bool known = above.error.empty() && below.error.empty();
      const double slope =
          known ? (above.final[at] - below.final[at]) / (2 * widths[c]) : std::numeric_limits<double>::quiet_NaN();
      (c < states ? island.A(r, c) : island.B(r, c - states)) = slope;
    }
  }
  return island;
}

// Of the first disc that moves, all at rest where they start: free flight is linear, whatever the width.
StepLinearization::FreeFlight BlackBoxSimulator::MeasureFreeFlight() const {
  std::vector<double> x = InitialState(scene_);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = i % kNumbers < 2 ? x[i] : 0.0;
  const auto moving =
      std::find_if(scene_.bodies.begin(), scene_.bodies.end(), [](const Body& body) { return !body.fixed; });
  if (moving == scene_.bodies.end()) return {1, step(), 0, 0, 1, step()};
  const int body = static_cast<int>(moving - scene_.bodies.begin());
  const std::vector<double> none(2 * num_bodies(), 0.0);
  const double small = moving->radius / 64;  // by which it moves, along x
  std::vector<Question> questions(4, StepFrom(x, none));
  questions[1].initial[kNumbers * body] += small;
  questions[2].initial[kNumbers * body + 2] += small / step();
  questions[3].control[2 * body] += small * moving->mass / (step() * step());
  const std::vector<Answer> answers = AnswersTo(questions);
  if (!std::all_of(answers.begin(), answers.end(), [](const Answer& answer) { return answer.error.empty(); })) {
    return {1, step(), 0, 0, 1, step()};
  }
  const auto by = [&](int question, int entry, double change) {
    return (answers[question].final[kNumbers * body + entry] - answers[0].final[kNumbers * body + entry]) / change;
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
