#include "sweep/solved.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <string>

#include "scene/control_problems.h"
#include "sweep/options.h"

namespace saltus {
namespace {

constexpr double kSame = 1e-6;   // relative, of losses
constexpr double kZero = 1e-12;  // a loss so small is none

// What the points of one solver and kind have in common.
struct Tally {
  int problems = 0, solved = 0, worse = 0, without = 0;
  std::vector<double> seconds;
  double memory = 0;
};

class Solved {
 public:
  Solved(const SweepStudy& study, const std::vector<StoredPoint>& points) : study_(study) {
    for (const StoredPoint& point : points) {
      double& best = best_.try_emplace(ProblemOf(point), std::numeric_limits<double>::infinity()).first->second;
      const double loss = Number(point, "exact_loss");
      if (loss < best) best = loss;
    }
    for (const StoredPoint& point : points) {
      const int kind = static_cast<int>(std::fmod(Number(point, kSeedOption), kNumControlKinds));
      for (const int row : {kind, kNumControlKinds}) {
        Count(point, &tallies_[{row, Text(point, "contact"), Text(point, "solver")}]);
      }
    }
  }

  Table ToTable() const {
    Table table({{"kind"},
                 {"contact"},
                 {"solver"},
                 {"problems"},
                 {"solved", 3},
                 {"worse_than_start"},
                 {"no_answer"},
                 {"median_seconds", 3},
                 {"most_seconds", 3},
                 {"most_memory_mib", 4}});
    for (const auto& [key, tally] : tallies_) {
      const auto& [kind, contact, solver] = key;
      std::vector<double> seconds = tally.seconds;
      std::sort(seconds.begin(), seconds.end());
      table.AddRow({kind < kNumControlKinds ? std::string(kControlKinds[kind]) : "all",
                    contact,
                    solver,
                    tally.problems,
                    double(tally.solved) / tally.problems,
                    tally.worse,
                    tally.without,
                    seconds.empty() ? Cell() : Cell(seconds[seconds.size() / 2]),
                    seconds.empty() ? Cell() : Cell(seconds.back()),
                    tally.memory});
    }
    return table;
  }

 private:
  size_t Column(const std::string& name) const {
    return std::find(study_.columns().begin(), study_.columns().end(), name) - study_.columns().begin();
  }
  double Number(const StoredPoint& point, const std::string& name) const {
    return ToNumber(point.result.row[Column(name)]);
  }
  std::string Text(const StoredPoint& point, const std::string& name) const {
    return ToCell(point.result.row[Column(name)]).Exact();
  }

  // All options but those of solvers.
  std::string ProblemOf(const StoredPoint& point) const {
    std::string problem;
    for (size_t i = 0; i < study_.options().size(); ++i) {
      const std::string& option = study_.options()[i];
      if (option == "contact" || option == "solver" || option == "precision" || option == "iterations" ||
          option == "learning_rate" || option.starts_with("search_") || option.starts_with("surrogate_") ||
          option.starts_with("feedback_")) {
        continue;
      }
      problem += option + "=" + ToCell(point.result.row[i]).Exact() + " ";
    }
    return problem;
  }

  void Count(const StoredPoint& point, Tally* tally) const {
    ++tally->problems;
    const double loss = Number(point, "exact_loss"), best = best_.at(ProblemOf(point));
    const double seconds = Number(point, "seconds"), memory = Number(point, "memory_mib");
    if (std::isfinite(seconds)) tally->seconds.push_back(seconds);
    if (memory > tally->memory) tally->memory = memory;
    if (point.result.status != PointStatus::kComputed || !std::isfinite(loss)) {
      ++tally->without;
      return;
    }
    if (loss <= best + kSame * std::abs(best) + kZero) ++tally->solved;
    if (loss > (1 + kSame) * Number(point, "initial_loss")) ++tally->worse;
  }

  const SweepStudy& study_;
  std::map<std::string, double> best_;  // least exact loss, by problem
  std::map<std::tuple<int, std::string, std::string>, Tally> tallies_;
};

}  // namespace

Table SolvedTable(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  return Solved(study, points).ToTable();
}

}  // namespace saltus
