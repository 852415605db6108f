#include <algorithm>
#include <cmath>
#include <utility>

#include "audit/blackbox/black_box_simulator.h"
#include "base/statistics.h"

namespace saltus {
namespace {

constexpr double kSpeed = 3;             // m/s: engines have speeds, up to 2 m/s, below which nothing rebounds
constexpr double kMostOfRadius = 0.125;  // that a disc may move in a step
constexpr int kSteps = 240;              // at least
constexpr int kPhases = 9;
// Displacements, in the motion of a step: small, so that the impact stays in its step, unless answers are very noisy.
constexpr double kSmall = 1e-3, kLarger = 0.05, kMuchNoise = 1e-11;
constexpr double kFelt = 16;  // noises by which a velocity must change
constexpr int kBlock = 8;     // steps that are asked for at a time
constexpr int kMostSteps = 4096;

// Returns a scene with the pair only.
Scene SceneOf(const Scene& scene, const Candidate& pair) {
  Scene alone;
  alone.name = "head_on";
  alone.contact = scene.contact;
  alone.contact.friction = 0;
  alone.bodies = {scene.bodies[pair.a]};
  if (pair.plane) {
    alone.planes = {{scene.planes[pair.b].name, Vec2d::Zero(), Vec2d(0, 1)}};
  } else {
    alone.bodies.push_back(scene.bodies[pair.b]);
    if (alone.bodies[0].fixed) std::swap(alone.bodies[0], alone.bodies[1]);
  }
  alone.control = {{0}, {Vec2d::Zero()}};
  alone.duration = scene.duration;
  alone.steps = scene.steps;
  alone.objective.terminal = {TerminalTerm{}};
  return alone;
}

}  // namespace

HeadOnImpact::HeadOnImpact(std::shared_ptr<BlackBox> box, const Scene& scene, const HeadOnPair& meeting, double noise,
                           const StopRequest& stop)
    : box_(std::move(box)),
      noise_(noise),
      stop_(stop),
      scene_(SceneOf(scene, meeting.pair)),
      grid_step_(scene.dt()),
      towards_(meeting.pair.plane ? Vec2d(0, -1) : Vec2d(1, 0)),
      reach_(scene_.bodies[0].radius + (meeting.pair.plane ? 0.0 : scene_.bodies[1].radius)),
      acceleration_(meeting.acceleration) {
  double smallest = scene_.bodies[0].radius;
  for (const Body& body : scene_.bodies) smallest = std::min(smallest, body.radius);
  const double gap_of_pair = smallest + reach_;  // anything, to begin with: each question has its own
  scene_.bodies[0].position = -(reach_ + gap_of_pair) * towards_;
  if (!meeting.pair.plane) scene_.bodies[1].position = scene_.bodies[1].velocity = Vec2d::Zero();
  traits_ = box_->Describe(scene_);
  reason_ = traits_.error.empty() ? traits_.not_applicable : traits_.error;
  speed_ = std::min(kSpeed, kMostOfRadius * smallest / step());
  num_steps_ = std::max(kSteps, scene.steps / 2) / traits_.grid_steps * traits_.grid_steps;
}

BlackBoxRequest HeadOnImpact::MakeRequest(const Start& start, int steps, double h) const {
  const Vec2d position = -(reach_ + start.gap) * towards_, velocity = start.speed * towards_;
  const Vec2d force = scene_.bodies[0].mass * start.acceleration * towards_;
  BlackBoxRequest request{BlackBoxRequest::Kind::kSimulate, steps * traits_.grid_steps, steps * h, {}, {}, {}};
  request.initial = {position[0], position[1], velocity[0], velocity[1]};
  if (scene_.num_bodies() > 1) request.initial.insert(request.initial.end(), 4, 0.0);
  for (int k = 0; k < request.steps; ++k) request.control.insert(request.control.end(), {force[0], force[1]});
  return request;
}

HeadOnImpact::Motion HeadOnImpact::MotionIn(std::span<const double> state) const {
  Motion motion;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    const double sign = i == 0 ? 1 : -1;
    motion.position += sign * (towards_[0] * state[4 * i] + towards_[1] * state[4 * i + 1]);
    motion.velocity += sign * (towards_[0] * state[4 * i + 2] + towards_[1] * state[4 * i + 3]);
  }
  return motion;
}

std::vector<BlackBoxAnswer> HeadOnImpact::RequestAnswers(const std::vector<BlackBoxRequest>& requests) const {
  std::vector<BlackBoxAnswer> answers = box_->Evaluate(scene_, requests, stop_);
  const bool all =
      std::all_of(answers.begin(), answers.end(), [](const BlackBoxAnswer& one) { return one.error.empty(); });
  return all ? std::move(answers) : std::vector<BlackBoxAnswer>{};
}

std::vector<HeadOnImpact::Motion> HeadOnImpact::Motions(const Start& start, double h, int first, int count) const {
  std::vector<Motion> motions;
  if (traits_.states) {
    BlackBoxRequest request = MakeRequest(start, first + count - 1, h);
    request.states = true;
    const std::vector<BlackBoxAnswer> answers = RequestAnswers({request});
    const std::size_t size = 4 * scene_.bodies.size();
    for (int k = first; !answers.empty() && k < first + count; ++k) {
      motions.push_back(MotionIn(std::span(answers[0].states).subspan(k * size, size)));
    }
    return motions;
  }
  std::vector<BlackBoxRequest> requests;
  for (int k = first; k < first + count; ++k) requests.push_back(MakeRequest(start, k, h));
  for (const BlackBoxAnswer& answer : RequestAnswers(requests)) motions.push_back(MotionIn(answer.final));
  return motions;
}

ContactRun HeadOnImpact::Run(double h, std::span<const double> from, bool onset_only) const {
  const Start start{from[0], from[1], acceleration_};
  RunRecorder recorder(onset_only);
  std::vector<Motion> all = {{-(reach_ + start.gap), start.speed}};
  double closing = start.speed;
  for (int k = 0; k < std::min(kMostSteps, MostSteps()) && !recorder.ended();) {
    const int count = std::max(kBlock, traits_.states ? k : 0);  // twice as many each time
    const std::vector<Motion> motions = Motions(start, h, k + 1, count);
    if (motions.empty()) return {};
    for (const Motion& motion : motions) {
      if (recorder.ended()) break;
      if (!recorder.begun()) closing = all.back().velocity;
      const double change = (all.back().velocity + h * acceleration_ - motion.velocity) / closing;
      const Motion& before = all[std::max(0, k - RunRecorder::kLead)];
      const std::vector<double> earlier = {-before.position - reach_, before.velocity};
      recorder.Add(change, -motion.velocity / closing, std::abs(change) > kFelt * noise_, earlier);
      all.push_back(motion);
      ++k;
    }
  }
  return recorder.Finish();
}

std::vector<HeadOnImpact::Motion> HeadOnImpact::Slopes(const std::vector<Start>& starts, int steps, double h) const {
  const double displacement = (noise_ > kMuchNoise ? kLarger : kSmall) * speed_ * h;
  std::vector<BlackBoxRequest> requests;
  for (const Start& start : starts) {
    for (const int sign : {1, -1}) {
      Start displaced = start;
      if (!traits_.gradient) displaced.gap -= sign * displacement;
      BlackBoxRequest& request = requests.emplace_back(MakeRequest(displaced, steps, h));
      if (!traits_.gradient) continue;
      // Derivatives of the relative position, and of the velocity, by the first disc's.
      request.kind = BlackBoxRequest::Kind::kGradient;
      request.final_cotangent.assign(request.initial.size(), 0.0);
      for (int i = 0; i < scene_.num_bodies(); ++i) {
        for (int j = 0; j < 2; ++j) {
          request.final_cotangent[4 * i + j + (sign == 1 ? 0 : 2)] = (i == 0 ? 1 : -1) * towards_[j];
        }
      }
    }
  }
  const std::vector<BlackBoxAnswer> answers = RequestAnswers(requests);
  std::vector<Motion> slopes;
  for (std::size_t i = 0; i + 1 < answers.size(); i += 2) {
    if (traits_.gradient) {
      const auto along = [&](const BlackBoxAnswer& one) {
        return towards_[0] * one.initial[0] + towards_[1] * one.initial[1];
      };
      slopes.push_back({along(answers[i]), along(answers[i + 1])});
    } else {
      const Motion above = MotionIn(answers[i].final), below = MotionIn(answers[i + 1].final);
      slopes.push_back({(above.position - below.position) / (2 * displacement),
                        (above.velocity - below.velocity) / (2 * displacement)});
    }
  }
  return slopes;
}

NormalMap HeadOnImpact::Linearize(double h, std::span<const double> before_largest) const {
  constexpr int kLead = RunRecorder::kLead;
  const std::vector<Motion> slopes =
      Slopes({{before_largest[0], before_largest[1], acceleration_}}, kLead + 1 + kLead, h);
  if (slopes.empty()) return {};
  return {slopes[0].position - kLead * h * slopes[0].velocity, slopes[0].velocity};
}

bool HeadOnImpact::IgnoresForce() const {
  if (acceleration_ == 0) return false;
  const double gap = FarBefore()[0];
  const std::vector<Motion> pushed = Motions({gap, speed_, acceleration_}, step(), 1, 1);
  const std::vector<Motion> free = Motions({gap, speed_, /*acceleration=*/0}, step(), 1, 1);
  return !pushed.empty() && !free.empty() && pushed[0].velocity == free[0].velocity;
}

std::optional<BlackBoxFindings::HeadOn> HeadOnImpact::Measure(int finer) const {
  const int steps = num_steps_ / traits_.grid_steps * finer;
  const double h = step() / finer, T = steps * h;
  std::vector<Start> starts;
  std::vector<double> rebounds, retentions, feedbacks;
  std::vector<BlackBoxRequest> requests;
  for (int i = 0; i < kPhases; ++i) {
    starts.push_back({speed_ * (T / 2 + (i + 0.5) / kPhases * h), speed_, /*acceleration=*/0});
    requests.push_back(MakeRequest(starts.back(), steps, h));
  }
  const std::vector<BlackBoxAnswer> answers = RequestAnswers(requests);
  const std::vector<Motion> slopes = Slopes(starts, steps, h);
  if (answers.empty() || slopes.empty()) return std::nullopt;
  for (int i = 0; i < kPhases; ++i) {
    rebounds.push_back(-MotionIn(answers[i].final).velocity / speed_);
    retentions.push_back(slopes[i].position - slopes[i].velocity * (T - starts[i].gap / speed_));
    feedbacks.push_back(h * slopes[i].velocity);
  }
  return BlackBoxFindings::HeadOn{steps * traits_.grid_steps, Median(rebounds), Median(retentions), Median(feedbacks)};
}

}  // namespace saltus
