// The experiments of the paper, which are run once; all reports take their results from here.
//
// An experiment is a scene with one contact model and precision: its gradient at the initial guess, the paper's
// gradient descent (1000 updates), and the same with other solvers. Task 1 is not optimised.
#pragma once

#include <glog/logging.h>

#include <ctime>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/table.h"
#include "output/figure.h"
#include "output/progress.h"
#include "programs/program.h"
#include "programs/scene_drawing.h"
#include "programs/simulators.h"
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
  std::string name;  // of the contact model, with its stiffness where that is not the scene's: "compliant_warp_kn1e2"
  Precision precision = Precision::kDouble;
  double learning_rate = 0;  // 0: gradient only
  std::vector<std::string> solvers;

  ModelGradient gradient;
  std::vector<CheckedRun> runs;  // one per solver; with iterates where velocities are optimised

  const CheckedRun* Find(const std::string& solver) const;
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

// The parts of the report of the paper: the figures of the experiments, and sections of further computations.

struct PaperFigure {
  std::string caption;  // one or two sentences
  Figure figure;
};

struct Section {
  std::vector<std::string> findings;  // in a sentence or two each
  std::vector<CaptionedTable> tables;
  std::vector<PaperFigure> figures;
};

// Gradient descent under each contact model: the angle of its gradient to the exact one, and the exact loss along the
// descent. Shows how optimisation can succeed with wrong gradients, and where it fails.

// Follows the descents. Contact models that cannot simulate a scene are left out there; so are those of `slow`. Returns
// std::nullopt if interrupted.
std::optional<Section> AuditDescents(const std::vector<TitledScene>& tasks, const std::vector<std::string>& contacts,
                                     const std::vector<std::string>& slow, int threads, ProgressMode mode);

// An audit of every contact model on the three tasks of the paper: the error of its gradient, its class, and the cost
// of a step.

// Audits the models. Precondition: `contacts` has `direct`, whose step is the unit of cost. Simulators are audited
// beside them; the costs of their steps are not measured. The findings are the classes: what each means, and which
// models belong to it. Returns std::nullopt if interrupted.
std::optional<Section> AuditFormulations(const std::vector<TitledScene>& tasks, std::vector<std::string> contacts,
                                         const std::vector<SimulatorCommand>& simulators, int threads,
                                         ProgressMode mode);

// A comparison of every solver under every contact model.
//
// Tasks 2 (without and with friction) and 3 under the models that the published comparisons report, and task 3 under
// all others. Losses under a contact model may not be compared between models; exact losses may, and their gap to the
// optimum is what is left to gain. Solvers that know exact dynamics only (optima on the grid, phases between events,
// the minimum principle) appear with the event-driven model.

// The solvers that run under models without experiments: none; those that take a second or two; or every general
// solver, however slow the model.
enum class OtherSolvers { kNone, kQuick, kEverySolver };

struct ComparedSolvers : Section {
  Table headline;              // of task 3 under exact dynamics: three solvers compared with the optimum
  PaperFigure controls;        // of task 3 under exact dynamics: the force of each solver
  std::set<std::string> slow;  // contact models whose gradients take so long that gradient descent was left out
};

// Takes the results that `experiments`, which have been run, contain, and computes the rest. Returns std::nullopt if
// interrupted.
std::optional<ComparedSolvers> CompareSolvers(const Experiments& experiments, OtherSolvers others, int threads,
                                              ProgressMode mode);

// The task of two balls by solvers that shoot over the impact and by those that treat it as an event, on the paper's
// time grid and on a finer one; and with bounds on the force, beside the optima in continuous time.

// An optimum of data/constrained_references.json under a bound on the force.
struct BoundedReference {
  Vec2d target = Vec2d::Zero();         // m, where the disc that is struck starts
  std::optional<double> max, max_norm;  // N
  double loss = 0, impact_time = 0;
  Vec2d at_start = Vec2d::Zero(), at_impact = Vec2d::Zero();  // N, the force without the bound, linear between

  Vec2d Force(double time) const;  // that within the bound
};

// Reads the references that the figure shows. Throws InputError.
std::vector<BoundedReference> ReadBoundedReferences(const std::string& path);

// Compares the solvers on the scene of the task. Returns std::nullopt if interrupted.
std::optional<Section> CompareStrikes(const Scene& scene, const std::vector<BoundedReference>& references, int threads,
                                      ProgressMode mode);

// Fits of one recording under every contact model: wrong gradients lead to wrong parameters. There are two fits: one to
// a recording of exact motion, in which both a model's motion and its gradient matter, and one to a recording of the
// model's motion, in which only its gradient matters.

// Fits under contact models. Those that cannot simulate the scene are left out, and plastic ones, which cannot explain
// a bounce. Returns std::nullopt if interrupted.
std::optional<Section> FitParameters(const std::vector<std::string>& contacts, int threads, ProgressMode mode);

// Learns the law of a ball dropped from four heights, whose restitution falls with speed. std::nullopt if interrupted.
std::optional<PaperFigure> LearnALaw();

// The figures of the paper, from the experiments.

// Returns a component of the force on the controlled disc at the middle of each interval.
Series ForceOf(const SolveReport& report, const Scene& scene, int axis = 0);
// Returns the optimal horizontal force of task 3 over time, without points if it is not known.
Series OptimalForce(const Scene& scene);
// The trajectories of the three tasks before and after gradient descent.
PaperFigure Trajectories(const Experiments& experiments);
// Loss and horizontal launch velocity of task 2 during gradient descent.
PaperFigure GroundWallLearning(const Experiments& experiments, double friction);
// Loss of task 3 during gradient descent, and the force that is learned.
PaperFigure TwoBallsLearning(const Experiments& experiments);
// Loss of task 3 under the compliant model at four stiffnesses.
PaperFigure StiffnessLearning(const Experiments& experiments);
// Loss of task 3 above the optimum with three solvers.
PaperFigure SolverLearning(const Experiments& experiments);

// Returns the result of gradient descent on a task under each model, as the model simulates it, and the exact motion of
// the control or velocity of the first; for a task that is not optimised, its guess.
Replay TaskReplay(const Experiments& experiments, const std::string& problem);

// The paper's printed numbers beside those of this library and the exact ones.

// One row of data/published.csv, with the value that this library computes for it.
struct PublishedRow {
  std::string table, problem, contact, quantity, note;
  double friction = 0;
  Precision precision = Precision::kDouble;
  std::string published;  // as printed; empty if the paper gives no number
  double expected = 0;    // what a faithful implementation gives
  double tolerance = 0;   // absolute, on |ours - expected|
  std::string verdict;    // of the printed number: match, published_misprint, solver_error, chaotic, ...

  std::optional<double> ours;
  std::optional<double> exact;  // the same quantity under exact dynamics

  // A number that rounding decides is shown but not judged.
  bool IsJudged() const { return verdict != "chaotic"; }
  bool Matches() const;
};

// Reads data/published.csv. Throws InputError.
std::vector<PublishedRow> ReadPublished(const std::string& path);

// Sets `ours` and `exact`.
void CompareWithPublished(const Experiments& experiments, std::vector<PublishedRow>* rows);

// Returns the names of the tables, in order ("T1", "T2", ...), and their captions.
std::vector<std::pair<std::string, std::string>> PublishedTables();

// Says whether our number is that of a faithful implementation, and what is wrong with the printed one.
std::string VerdictInWords(const PublishedRow& row);

// Returns a table published | ours | exact | verdict, for the rows of one table of the paper.
Table ToTable(const std::vector<PublishedRow>& rows, const std::string& name);

// Returns a table in the paper's layout: a row for each model and a column for each quantity, the published number
// above ours, coloured where they differ. Adds the notes that the cells refer to by number. The last row has the exact
// values.
Table PaperTable(const std::vector<PublishedRow>& rows, const std::string& name, std::vector<std::string>* notes);

}  // namespace saltus
