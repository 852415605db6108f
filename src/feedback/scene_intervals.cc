#include "feedback/scene_intervals.h"

#include <glog/logging.h>

#include <utility>

#include "base/number_text.h"
#include "scene/units.h"
#include "simulate/converted_simulator.h"

namespace saltus {
namespace {

// A simulator of equal steps that are a part of the scene's motion, in `part` with their number and duration. What
// decides when discs touch is a number in the natural units of the whole scene, which depend on its duration.
std::unique_ptr<Simulator> MakePart(const Contact& contact, const Scene& whole, const Scene& part) {
  if (!contact.entry()->traits.event_driven || whole.units.natural) {
    return MakeSimulator(contact, part, Precision::kDouble);
  }
  Scene natural = ToNaturalUnits(whole);
  natural.steps = part.steps;
  natural.duration = part.duration * UnitFactors(whole.units, natural.units).time;
  return ConvertUnits(part, MakeSimulator(contact, natural, Precision::kDouble));
}

constexpr double kAtStart = 1e-9;  // of the length of an interval: a contact has lasted from the start

}  // namespace

std::vector<SceneEvent> PlannedEvents(const SceneIntervals& motion) {
  const Scene& scene = motion.simulator().scene();
  std::vector<SceneEvent> events;
  TouchEvents touch_events;
  for (int k = 0; k < motion.size(); ++k) {
    if (motion[k].simulator == nullptr) continue;
    const std::span<const Touch> touches = motion.touches(k);
    touch_events.Add(touches, [&](std::size_t i) {
      const Touch& touch = touches[i];
      if (motion[k].LastsFromStart(touch)) return;
      const Candidate& pair = touch.candidate;
      SceneEvent& event = events.emplace_back(SceneEvent{LabelOf(pair, k), i, {}});
      if (!scene.bodies[pair.a].fixed) event.discs.push_back(pair.a);
      if (!pair.plane && !scene.bodies[pair.b].fixed) event.discs.push_back(pair.b);
    });
  }
  return events;
}

bool SceneIntervals::Interval::LastsFromStart(const Touch& touch) const {
  return begin == 0 && touch.time >= 0 && touch.time <= kAtStart * length && touch.kind == ContactKind::kSustained;
}

SceneIntervals::SceneIntervals(const Simulator& simulator) : whole_(simulator.scene()) {
  AddStepsOf(simulator);
  AddTouchesOf(simulator, 0);
}

SceneIntervals::SceneIntervals(std::unique_ptr<Simulator> simulator) : whole_(simulator->scene()) {
  AddStepsOf(*simulator);
  own_.push_back(std::move(simulator));
}

SceneIntervals::SceneIntervals(const Contact& contact, const Scene& scene, std::span<const double> lengths)
    : whole_(scene) {
  const int grid_steps = FindContactModel(contact)->grid_steps;
  for (std::size_t k = 0, end = 0; k < lengths.size(); k = end) {
    while (end < lengths.size() && lengths[end] == lengths[k]) ++end;
    const auto count = static_cast<int>(end - k);
    if (lengths[k] == 0) {
      intervals_.insert(intervals_.end(), count, {.begin = end_});
      continue;
    }
    Scene part = scene;
    part.steps = count * grid_steps;
    if (k > 0 || end < lengths.size()) part.duration = count * lengths[k];
    own_.push_back(MakePart(contact, scene, part));
    AddStepsOf(*own_.back());
  }
  CHECK(any_ != nullptr) << "expected an interval that lasts";
}

void SceneIntervals::AddStepsOf(const Simulator& simulator) {
  for (int step = 0; step < simulator.num_steps(); ++step) {
    intervals_.push_back({end_ + step * simulator.step(), simulator.step(), &simulator, step});
  }
  end_ += simulator.scene().duration;
  any_ = &simulator;
}

void SceneIntervals::AddTouchesOf(const Simulator& simulator, int first) {
  touches_.resize(intervals_.size());
  for (const StepTouch& at : simulator.touches()) touches_[first + at.step].push_back(at.touch);
}

std::string SceneIntervals::Rollout(std::vector<double> x, std::span<const double> control) {
  const std::size_t width = simulator().control_width();
  touches_.assign(intervals_.size(), {});
  int first = 0;
  for (const std::unique_ptr<Simulator>& part : own_) {
    while (intervals_[first].simulator != part.get()) ++first;
    const std::span<const double> rows = control.subspan(first * width, part->num_steps() * width);
    if (!part->Rollout(x, rows)) {
      const std::string since =
          own_.size() > 1 ? ", of those from t = " + ToText(intervals_[first].begin, 6) + " s on" : "";
      return part->FailureReason() + since;
    }
    std::vector<double> end(part->state_size());
    part->GetState(part->num_steps(), end);
    x = ToInitial(end, part->num_bodies());
    AddTouchesOf(*part, first);
  }
  return "";
}

std::unique_ptr<Simulator> SceneIntervals::MakeStep(int k, double length) const {
  Scene part = intervals_[k].simulator->scene();
  part.steps = 1;
  part.duration = length;
  return MakePart(Contact(simulator().traits().name), whole_, part);
}

std::vector<double> SceneIntervals::State(int k) const {
  std::vector<double> x(simulator().state_size());
  while (k < size() && intervals_[k].simulator == nullptr) ++k;
  if (k < size()) {
    intervals_[k].simulator->GetState(intervals_[k].step, x);
  } else {
    simulator().GetState(simulator().num_steps(), x);  // the last one
  }
  return x;
}

}  // namespace saltus
