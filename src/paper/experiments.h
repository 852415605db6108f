// The experiments of the paper, which are run once; all reports take their results from here.
//
// An experiment is a scene with one contact model and precision: its gradient at the initial guess, the paper's
// gradient descent (1000 updates), and the same with other solvers. Task 1 is not optimised.
#pragma once

#include <glog/logging.h>

#include <ctime>
#include <map>
#include <string>
#include <vector>

#include "programs/program.h"
#include "programs/solve.h"
#include "saltus/audit/audit.h"

namespace saltus {

inline constexpr int kPublishedIterations = 1000;  // of gradient descent

struct TitledScene {
  std::string title;
  Scene scene;
};

struct Experiment {
  Scene scene;
  std::string contact;
  Precision precision = Precision::kDouble;
  double learning_rate = 0;  // 0: gradient only
  std::vector<std::string> solvers;

  ModelGradient gradient;
  std::vector<SolvedRun> runs;  // one per solver; with iterates where velocities are optimised

  const SolvedRun* Find(const std::string& solver) const;
};

class Experiments {
 public:
  // Loads the scenes of the paper from `problems_dir`. Throws InputError.
  explicit Experiments(const std::string& problems_dir);

  // Runs everything on `threads` threads. Returns false if interrupted.
  bool Run(int threads, ProgressMode progress);

  // Returns the experiment of that problem ("two_balls"), friction, contact model and precision, or null. `contact` may
  // carry a stiffness: "compliant_warp_kn1e2".
  const Experiment* Find(const std::string& problem, double friction, const std::string& contact,
                         Precision precision) const;
  // Returns the exact counterpart: the event-driven model in double precision.
  const Experiment* Exact(const std::string& problem, double friction) const;

  const std::vector<Experiment>& all() const { return experiments_; }
  const Scene& scene(const std::string& problem) const { return scenes_.at(problem); }

 private:
  void Add(const std::string& problem, double friction, const std::string& contact, Precision precision,
           double stiffness);

  std::map<std::string, Scene> scenes_;
  std::vector<Experiment> experiments_;
  std::map<std::string, int> index_;
};

// Writes the files that the authors' published analysis notebooks read, under the same names and keys: results/*.npz
// below `output_dir`. Throws InputError if a file cannot be written.
void WriteNotebookFiles(const Experiments& experiments, const std::string& output_dir);

// Returns the CPU time of this thread, s, which other load of the machine disturbs little.
inline double ThreadTime() {
  timespec time;
  CHECK_EQ(clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time), 0);
  return time.tv_sec + 1e-9 * time.tv_nsec;
}

}  // namespace saltus
