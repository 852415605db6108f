#include "control/event_phases.h"

#include <glog/logging.h>

#include <algorithm>

namespace saltus {

EventPhases::EventPhases(const Scene& scene, std::vector<Candidate> sequence, std::vector<int> intervals)
    : scene_(scene), sequence_(std::move(sequence)), intervals_(std::move(intervals)) {
  CHECK_GT(scene_.objective.effort, 0);
  CHECK(intervals_.empty() || intervals_.size() == sequence_.size() + 1);
  for (const Plane& plane : scene_.planes) planes_.push_back(MakeHalfPlane(plane));
  pushed_.assign(scene_.num_bodies(), false);
  for (int body : scene_.control.bodies) pushed_[body] = true;
  for (int k = 0; k < num_impacts(); ++k) {
    const Candidate& c = sequence_[k];
    laws_.push_back(MakeImpactConstants(scene_, c));
    CHECK_GT(laws_[k].inverse_mass_a + laws_[k].inverse_mass_b, 0);
    index_.push_back(num_variables_);
    const int pushed = pushed_[c.a] + PushesB(k);
    num_variables_ += pushed == 2 ? 8 : pushed == 1 ? 4 : 1;
    num_arcs_ += pushed;
    num_gaps_ += pushed == 0;
  }
  aim_index_.assign(scene_.num_bodies(), -1);
  for (const TerminalTerm& term : scene_.objective.terminal) {
    if (!IsPushed(term.body) || IsAimed(term.body)) continue;
    aim_index_[term.body] = num_variables_;
    num_variables_ += 4;
    ++num_arcs_;
  }
}

double EventPhases::Loss(const Path<double>& path) const {
  std::vector<double> residuals(num_loss_residuals());
  LossResiduals(path, residuals.data());
  double loss = 0;
  for (double r : residuals) loss += r * r;
  return loss;
}

std::vector<double> EventPhases::Variables(std::span<const double> times, std::span<const State> before,
                                           const State& end) const {
  std::vector<double> z(num_variables_);
  for (int k = 0; k < num_impacts(); ++k) {
    double* at = &z[index_[k]];
    *at++ = times[k];
    if (!IsSteered(k)) continue;
    const Candidate& c = sequence_[k];
    const State& x = before[k];
    Vec2d normal = c.plane ? planes_[c.b].normal : Vec2d(x.p[c.a] - x.p[c.b]);
    Vec2d w = x.v[c.a];
    if (c.plane) {
      *at++ = Dot(Perpendicular(normal), x.p[c.a]);
    } else {
      const double angle = std::atan2(normal[1], normal[0]);
      *at++ = angle;
      normal = {std::cos(angle), std::sin(angle)};
      w -= x.v[c.b];
    }
    *at++ = Dot(normal, w);
    *at++ = Dot(Perpendicular(normal), w);
    if (IsPushed(c.a) && PushesB(k)) std::copy_n(x.v[c.b].data(), 2, std::copy_n(x.p[c.b].data(), 2, at));
  }
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (!IsAimed(i)) continue;
    std::copy_n(end.v[i].data(), 2, std::copy_n(end.p[i].data(), 2, &z[aim_index_[i]]));
  }
  return z;
}

void EventPhases::Control(const Path<double>& path, std::vector<double>* control,
                          std::vector<double>* durations) const {
  CHECK(!intervals_.empty());
  const int width = scene_.control_width();
  std::vector<int> column(scene_.num_bodies(), -1);
  for (int c = 0; c < scene_.num_controlled(); ++c) column[scene_.control.bodies[c]] = 2 * c;
  control->clear();
  durations->clear();
  double start = 0;
  for (int j = 0; j <= num_impacts(); ++j) {
    const double end = j < num_impacts() ? path.impacts[j].time : scene_.duration;
    const double h = (end - start) / intervals_[j];
    for (int i = 0; i < intervals_[j]; ++i) {
      const double middle = start + (i + 0.5) * h;
      durations->push_back(h);
      control->resize(control->size() + width, 0.0);
      double* row = control->data() + control->size() - width;
      for (const Arc<double>& arc : path.arcs) {
        if (j < arc.from.phase || j > arc.last_phase) continue;
        const double t = middle - arc.from.time - 0.5 * arc.length;
        for (int d = 0; d < 2; ++d) {
          row[column[arc.body] + d] = scene_.bodies[arc.body].mass * (arc.mean[d] + t * arc.slope[d]);
        }
      }
    }
    start = end;
  }
}

std::vector<int> DistributeIntervals(const Scene& scene, const std::vector<Candidate>& sequence,
                                     std::span<const double> times) {
  const auto pushed = [&](int body) {
    return std::find(scene.control.bodies.begin(), scene.control.bodies.end(), body) != scene.control.bodies.end();
  };
  // Control acts in the phases up to the last impact of a pushed disc; in all, if one has a target.
  const int phases = static_cast<int>(sequence.size()) + 1;
  int working = 0;
  for (int k = 0; k + 1 < phases; ++k) {
    if (pushed(sequence[k].a) || (!sequence[k].plane && pushed(sequence[k].b))) working = k + 1;
  }
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (pushed(term.body)) working = phases;
  }
  constexpr int kLeast = 2;
  std::vector<int> intervals(phases, 1);
  int left = scene.steps - (phases - working) - kLeast * working;
  if (left < 0) return {};
  double time_left = working == phases ? scene.duration : working > 0 ? times[working - 1] : 0.0;
  for (int j = 0; j < working; ++j) {
    const double length = (j + 1 < phases ? times[j] : scene.duration) - (j > 0 ? times[j - 1] : 0.0);
    const int share = j + 1 == working ? left : static_cast<int>(std::lround(left * length / time_left));
    intervals[j] = kLeast + share;
    left -= share;
    time_left -= length;
  }
  if (working == 0) intervals[0] = scene.steps - (phases - 1);
  return intervals;
}

}  // namespace saltus
