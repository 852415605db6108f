// The repeated parts of a search over collision sequences: a solve from some start, and the sequences next to the
// motion that it finds. Each is a function of its task alone, so that several run at the same time.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "saltus/solve/solver.h"
#include "solve/phases/phase_solution.h"

namespace saltus {

struct SearchTask {
  enum class Kind {
    kAlong,    // along `sequence` from the motion `from`
    kMend,     // from the motion `from`, along the sequences that mending leads to (sequence_update.h)
    kShoot,    // by ceres_lm from constant `forces`, or from the control of `from`
    kDescend,  // by gd from `forces`
    kShare,    // along `sequence` from the optimum `from`, with intervals shared better between its phases
  };
  Kind kind = Kind::kAlong;
  ContactSequence sequence = {};
  std::shared_ptr<const Trial> from = nullptr;  // shared by the neighbours of a motion
  std::vector<Vec2d> forces = {};
  bool coarse = false;  // kShoot: on fewer intervals, each of which is several of the scene's
  double most_work = std::numeric_limits<double>::infinity();  // as SearchOptions::work; cuts its iterations
};

// The work of one gradient or Jacobian, in the unit of SearchOptions::work: by a rollout; along so many impacts in
// closed arcs; with a cost for every step.
double WorkByRollout(const Scene& scene);
double WorkByArcs(const Scene& scene, size_t impacts);
double WorkBySteps(const Scene& scene);

// The result of a solve.
struct SearchFinding {
  Trial trial;           // the motion, if trial.exact.ok
  bool optimal = false;  // it is an optimum, and really happens
  std::string remark;    // why it is none
  std::optional<Certificate> certificate;
  std::vector<Trial> aside;  // of a saddle: better motions beside it
  int jacobians = 0;
  double work = 0;  // as SearchOptions::work
};
SearchFinding SolveTask(const SolveRequest& request, const SolverOptions& options, const SearchTask& task);

// The sequences that differ from that of `trial` by one impact inserted, removed or replaced by one of another pair: at
// most so many, first of all removals, then those whose new pair comes nearest to a touch. Precondition: impacts only.
std::vector<ContactSequence> NeighboursOf(const Scene& scene, const Trial& trial, bool* left_out);

}  // namespace saltus
