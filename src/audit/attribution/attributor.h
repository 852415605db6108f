// How attribution.h goes about it: the contacts of a rollout as intervals of steps, and what is wrong over each.
#pragma once

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "audit/attribution/impact_faults.h"
#include "audit/attribution/pulled_costate.h"
#include "audit/attribution/step_map.h"
#include "saltus/audit/attribution.h"
#include "saltus/scene/walls.h"

namespace saltus::internal {

inline constexpr int kLongest = 1024;  // steps of one interval; a contact that lasts longer is cut
inline constexpr double kSmallError = 1e-3;
// Of a scene with more discs costates are pulled back, instead of matrices multiplied.
inline constexpr int kMostDiscsByMatrices = 16;
inline constexpr std::size_t kKeptNumbers = std::size_t{1} << 23;  // of states

// A pair, and the first and last step in which the model lets it touch.
struct Meeting {
  Candidate pair;
  int first = 0, last = 0;
};

// Steps [begin, end) of the model, and the pairs that meet in them: connected by discs that move, so that other discs
// may meet in the same steps without being part of it.
struct Interval {
  int begin = 0, end = 0;
  std::vector<Meeting> meetings;

  int first_touch() const {
    int first = meetings.front().first;
    for (const Meeting& meeting : meetings) first = std::min(first, meeting.first);
    return first;
  }
  int last_touch() const {
    int last = 0;
    for (const Meeting& meeting : meetings) last = std::max(last, meeting.last);
    return last;
  }
  // Steps of the longest meeting.
  int longest() const {
    int steps = 0;
    for (const Meeting& meeting : meetings) steps = std::max(steps, meeting.last - meeting.first + 1);
    return steps;
  }
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

  Attribution Run();

 private:
  const Simulator& model() const { return *model_; }
  double h() const { return model_->step(); }
  std::unique_ptr<Simulator> Simulate(const Contact& contact, const Scene& scene) const {
    std::unique_ptr<Simulator> simulator = MakeSimulator(contact, scene, Precision::kDouble);
    simulator->set_stop(stop_);
    return simulator;
  }

  // Of the rollout. The last ones are kept, as looking back may simulate again: by one thread at a time.
  std::vector<double> StateAt(int k) const {
    const std::lock_guard lock(looking_back_);
    if (const auto known = states_.find(k); known != states_.end()) return known->second;
    if (states_.size() >= kKeptNumbers / model_->state_size()) states_.clear();
    std::vector<double>& x = states_[k];
    x.resize(model_->state_size());
    model_->GetState(k, x);
    return x;
  }
  // The same without rotation that is the model's own.
  std::vector<double> PlainStateAt(int k) const {
    std::vector<double> x = StateAt(k);
    if (model_->body_size() == size_) return x;
    std::vector<double> plain;
    for (int i = 0; i < model_->num_bodies(); ++i) {
      plain.insert(plain.end(), x.begin() + i * model_->body_size(), x.begin() + i * model_->body_size() + size_);
    }
    return plain;
  }
  ForceOfStep ForcesFrom(int begin, int finer = 1) const {
    return [this, begin, finer](int k, std::span<double> force) {
      model_->ExpandForce(control_, begin + k / finer, force);
    };
  }
  // For the model `contact` over the time of an interval, cut into `steps` of its own steps.
  Scene SceneOver(const Contact& contact, const Interval& interval, int steps) const {
    Scene scene = scene_;
    scene.duration = (interval.end - interval.begin) * h();
    scene.steps = steps * CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
    return scene;
  }
  std::unique_ptr<Simulator> SimulatorOf(const Contact& contact, const Interval& interval, int steps) const {
    return Simulate(contact, SceneOver(contact, interval, steps));
  }

  std::vector<Interval> FindIntervals() const;
  void AddTouch(const StepTouch& at, std::vector<Interval>* intervals) const;
  bool Overlap(const Interval& interval, int k) const;
  bool Involves(const Interval& interval, const Candidate& pair) const;
  bool HasExactImpact(const Interval& interval) const;
  StepMap ExactOver(const Interval& interval, const std::vector<int>* bodies) const;
  std::vector<StepTouch> TouchesOver(const Contact& contact, const Interval& interval) const;
  std::vector<StepTouch> ExactTouches(const Interval& interval) const;
  std::vector<StepTouch> OwnTouches(const Interval& interval) const;
  StepMap OwnMap(const Interval& interval, const std::vector<int>& bodies, int finer = 1) const;
  StepMap MapOver(const Contact& contact, const Interval& interval, int finer, const std::vector<int>& bodies) const;
  void FindCostates(const std::vector<Interval>& intervals);
  bool IsCrowd() const { return scene_.num_bodies() > kMostDiscsByMatrices && model_->body_size() == size_; }
  Eigen::VectorXd PullBackOver(int begin, int end, const Eigen::VectorXd& costate) const;
  PulledCostate PullBackOver(const Contact& contact, const Interval& interval, int finer,
                             const std::vector<int>& bodies, const Eigen::VectorXd& lambda) const;
  void CompareCrowd(const Interval& interval, const std::vector<int>& bodies, const Eigen::VectorXd& lambda,
                    const std::vector<StepTouch>& exact, ContactError* error) const;
  static Block LargestBlock(const std::function<double(bool to_velocity, bool from_velocity)>& size);
  ContactError Compare(const Interval& interval, const Eigen::VectorXd& costate) const;
  std::string Why(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                  const std::vector<int>& bodies) const;
  static std::string WhyWithoutMaps(const Interval& interval, const std::vector<StepTouch>& exact);
  static std::string WhyInOneStep(const std::vector<StepTouch>& exact);
  std::optional<PairImpact> OnlyImpact(const Interval& interval, const StepMap& exact) const;
  std::string WhyUnresolved(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                            const std::vector<int>& bodies) const;
  int FinerSteps(const Interval& interval) const;
  std::string DescribeUnresolved(const Interval& interval, double coarse_error, double fine_error) const;
  // Drops touches that no chain of touches connects with the interval; collects the discs that move of the others.
  void KeepConnected(Interval interval, std::vector<StepTouch>* exact, std::vector<StepTouch>* own,
                     std::vector<int>* bodies) const;
  double Norm(const Eigen::VectorXd& costate, const std::vector<int>& bodies) const;
  std::string PairName(const Candidate& pair) const;
  std::string CompareSequences(const std::vector<Interval>& intervals) const;
  std::vector<ContactError> CompareAll(const std::vector<Interval>& intervals) const;

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

}  // namespace saltus::internal
