// Solves that follow one another and are reported as one.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/solve/solver.h"

namespace saltus {

class SolveChain {
 public:
  // The options are those of all solves together, and outlive this object.
  explicit SolveChain(const SolverOptions& options) : options_(options) {}

  // Returns the options of the next solve: the iterations that are left, and a callback that counts on.
  SolverOptions Next() const;
  bool IsOutOfIterations() const { return iterations_ >= options_.limits.iterations; }

  // Counts a solve. A report that has no losses counts with its time alone.
  void Add(const SolveReport& report);

  // Returns a report that was added last, or one before it that is better, with the losses, iterates, evaluations and
  // seconds of all solves, and as from the first one's initial guess.
  SolveReport Finish(SolveReport report) const;

 private:
  const SolverOptions& options_;
  std::vector<double> losses_;
  std::vector<std::vector<double>> iterates_;
  int iterations_ = 0, last_ = 0, evaluations_ = 0;  // last_: iterations before the last solve
  double seconds_ = 0, initial_violation_ = 0;
};

// Whether a solve has ended better than another one: with an optimum, else nearer to the constraints, else with a
// lower loss.
bool EndsBetter(const SolveReport& report, const SolveReport& than);

// Solves by the solver of that name from the initial guess, or from the solution of a report unless that is null.
// Returns kNotApplicable for a solver that does not support the problem.
using SolveByName =
    std::function<SolveReport(std::string_view name, const SolverOptions& options, const SolveReport* from)>;

// The solver `auto`: solves by one solver after the other until one ends with an optimum, within the iterations of the
// options; where none does, those of `refine` go on from the best end. Returns the report of the solve that ends best.
// Its `solver` is the name of that solver, and its reason begins with that name and with `why`, the cause of the order.
// `find_loss_of_reach` returns why an optimum may be one only as it cannot feel the control any longer, or nothing; the
// solvers that follow are tried then, too, and a lower loss counts more than that optimum.
SolveReport SolveInTurn(const std::vector<std::string_view>& order, const std::vector<std::string_view>& refine,
                        const std::string& why, const SolverOptions& options, const SolveByName& solve,
                        const std::function<std::string(const SolveReport&)>& find_loss_of_reach = nullptr);

}  // namespace saltus
