// Simulation of a plan under feedback and noise, for hybrid systems and for scenes under any contact model, with
// statistics.
//
// Events that come early or late (reference spreading; Rijnen, Saccon, Nijmeijer 2015): the state is compared with that
// of the plan after the same number of events.
//
//   * If the plan's event has not happened yet, the reference is the planned motion before the event, continued without
//     it, with the control and the gain of the last interval that begins before it.
//   * If it has happened already, the reference is the planned motion after the event, continued backwards, with the
//     control and the gain of the first interval that begins after it.
//   * If other events have happened than planned, or two more or fewer, there is no feedback: the planned control acts.
//   * In a scene, events that share no disc that moves may happen in another order. The number of impacts of a pair
//     before its sustained contact, and during it, is not compared.
//
// A motion of a hybrid system is continued by the flow of the mode; that of a scene by free flight of the discs of the
// event, with a constant angular velocity. States of a scene in this file have the numbers of each disc in turn, [p_x
// p_y v_x v_y], with [angle, angular velocity] behind them in scenes with spin, as Simulator::GetState() (simulator.h).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "saltus/feedback/covariance.h"
#include "saltus/feedback/regulator.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// The identity of an event: mode, guard and next mode of a hybrid system; in a scene disc, disc or wall (Candidate),
// and 1 for a wall. Equal events may happen in different intervals.
struct EventLabel {
  int a = 0, b = 0, c = 0;
  int interval = 0;  // the control interval of the event; not compared
  friend bool operator==(const EventLabel& x, const EventLabel& y) { return x.a == y.a && x.b == y.b && x.c == y.c; }
};

// A planned motion, with the data that feedback needs.
struct Plan {
  int num_controls = 0;                      // m
  std::vector<double> control = {};          // K x m, row-major
  std::vector<Eigen::VectorXd> states = {};  // K + 1: at the beginning of each interval, and at the end
  std::vector<int> phases = {};              // K + 1: how many events have happened then
  std::vector<EventLabel> events = {};       // in order of time
  // Each event has the motion before it, continued to the beginnings of intervals `first` and later that follow it and
  // precede the next event; and the motion after it, continued backwards to the beginnings of intervals `first` and
  // later between the event before and it. The control and the gain are those of `interval`.
  struct Branch {
    int first = 0, interval = 0;
    std::vector<Eigen::VectorXd> states = {};
  };
  std::vector<Branch> late = {}, early = {};  // one for each event: if it happens later, or earlier, than planned
  // The discs of each event of a scene that move: events that share none may change their order. Empty for a hybrid
  // system, whose events may not.
  std::vector<std::vector<int>> discs = {};
  // A sustained contact of a scene, from node `from` to the end of interval `to`. The events of the pair from `event`
  // to `from`, with which it comes to rest, count as one; -1 if it lasts from the start. Later events of the pair do
  // not count.
  struct SustainedContact {
    EventLabel pair;
    int event = -1, from = 0, to = 0;
  };
  std::vector<SustainedContact> sustained = {};

  int num_intervals() const { return static_cast<int>(phases.size()) - 1; }
};
// Make the plan of the last rollout, which succeeded, of `input` or under `control` (K rows of the control width).
// Precondition: the input or control is that of the rollout.
Plan MakePlan(HybridSimulator& motion, const HybridInput& input);
Plan MakePlan(const Simulator& motion, std::span<const double> control);

// Plan and linearization of the exact motion of a scene, on control intervals of any lengths.
struct ScenePlan {
  std::string reason = {};  // why there is no plan, as in scenes with drag, springs or prescribed motions; else empty
  std::string remark = {};  // why derivatives are one-sided, or do not describe disturbed motions; empty if they do
  Plan plan = {};
  LinearMotion linear = {};
  std::vector<double> lengths = {};  // of the K intervals, s
};
// Plans a scene. The K intervals of the control last `durations` (K numbers >= 0, s, which replace the scene's
// duration), or are equal if there are none; a scene without a control has its own steps. `initial` as in simulator.h.
ScenePlan PlanScene(Scene scene, const std::vector<double>& initial, const std::vector<double>& control,
                    const std::vector<double>& durations = {});

// Writes the control of interval k (m numbers), given the state at its beginning and the events that have happened.
// Writes the planned control and returns false if there is no feedback by the rules above. `gains` as in Regulator;
// empty: planned control.
bool FeedbackControl(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, int k, const Eigen::VectorXd& x,
                     std::span<const EventLabel> events, std::span<double> u);

// The system under control, which advances by one interval after the other.
class Plant {
 public:
  virtual ~Plant() = default;
  // Starts a run from state x, at the beginning of interval 0.
  virtual void Start(const Eigen::VectorXd& x) = 0;
  // Advances through interval k under a constant control. Returns false if there is no motion.
  virtual bool Advance(int k, std::span<const double> u) = 0;

  int mode() const { return mode_; }
  Eigen::VectorXd& state() { return x_; }  // noise is added to it
  const std::vector<EventLabel>& events() const { return events_; }

 protected:
  int mode_ = 0;
  Eigen::VectorXd x_ = {};
  std::vector<EventLabel> events_ = {};  // since Start
};
// Makes a plant of the system of a motion, with its steps. The mode at the start, the parameters and the intervals are
// those of `input`, of which `motion` is the last rollout. If noise moves the state behind a guard, the event of the
// guard happens at once if the guard falls there; otherwise the guard is armed once it is above zero.
std::unique_ptr<Plant> MakePlant(const HybridSimulator& motion, const HybridInput& input);
// Makes a plant of the scene under the contact model of the simulator. A contact over several steps is one event. A
// state has four numbers for each disc (six with spin), or all numbers of the state of the model.
std::unique_ptr<Plant> MakePlant(std::unique_ptr<Simulator> simulator);
// Makes such a plant on intervals that last `lengths` (K numbers >= 0, s), each of which is one step of the model.
// Precondition: their sum is the scene's duration, and the contact model is applicable to the scene.
std::unique_ptr<Plant> MakePlant(const Contact& contact, const Scene& scene, std::span<const double> lengths);

struct ClosedLoopRun {
  bool ok = false;          // whether there is a motion
  bool as_planned = false;  // whether the events are those of the plan, in their order
  int mode = 0;             // at the end
  Eigen::VectorXd final_state = {};
  std::vector<double> control = {};  // the control that acted, K x m, with noise
};
// Simulates one run from the planned initial state, with the noise of number `sample` of a seed.
ClosedLoopRun RunClosedLoop(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, const Noise& noise,
                            std::uint64_t seed, int sample, Plant* plant);

struct MonteCarloOptions {
  int samples = 1000;  // number of runs, > 0
  std::uint64_t seed = 1;
  int threads = 0;             // 0: one per core. Results do not depend on it.
  StopRequest stop = nullptr;  // ends the study; the result has the runs until then
};
struct MonteCarlo {
  int simulated = 0;  // all runs, of which fewer than samples if the study was ended
  int failed = 0;     // runs without a motion, which do not count below
  int off_plan = 0;   // runs with a motion whose events are not those of the plan
  int counted = 0;    // runs whose final state has the planned size, which mean and covariance are of
  // The mean of the final state and its covariance; NaN where no run counts, or fewer than two.
  Eigen::VectorXd mean = {};
  Eigen::MatrixXd covariance = {};
  // The mean over the runs with a motion, and its standard error; 0 with fewer than two of them, or without a `loss`.
  double loss = 0, loss_error = 0;
};
// Simulates noisy runs, each from the planned initial state plus noise. `make_plant` and `loss`, which returns the loss
// of a run, are called from several threads. Results are the same for any number of threads.
MonteCarlo RunMonteCarlo(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, const Noise& noise,
                         const std::function<std::unique_ptr<Plant>()>& make_plant, const MonteCarloOptions& options,
                         const std::function<double(const ClosedLoopRun&)>& loss = nullptr);

}  // namespace saltus
