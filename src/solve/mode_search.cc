#include "mode_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <string>

#include "phase_run.h"
#include "physics/units.h"

namespace saltus {
namespace {

constexpr int kMostImpacts = 6;
constexpr int kStarts = 3;            // motions from which a sequence is tried
constexpr double kBound = 3;          // times the best loss
constexpr double kSameLoss = 1e-6;    // relative: the same optimum of a sequence
constexpr int kMostIterations = 80;   // of Ceres in one solve
constexpr double kLossChange = 0.02;  // relative, in the last steps of a solve

// A sequence as something to be compared.
using Key = std::vector<std::array<int, 3>>;
Key KeyOf(const ContactSequence& sequence) {
  Key key;
  for (const Candidate& c : sequence) key.push_back({c.a, c.b, c.plane});
  return key;
}

// All sequences that differ by one impact.
std::vector<ContactSequence> Neighbours(const ContactSequence& sequence, const ContactSequence& pairs) {
  std::vector<ContactSequence> neighbours;
  for (size_t i = 0; i < sequence.size(); ++i) {
    neighbours.push_back(sequence);
    neighbours.back().erase(neighbours.back().begin() + i);
  }
  for (size_t i = 0; i <= sequence.size(); ++i) {
    for (const Candidate& pair : pairs) {
      neighbours.push_back(sequence);
      neighbours.back().insert(neighbours.back().begin() + i, pair);
    }
  }
  for (size_t i = 0; i < sequence.size(); ++i) {
    for (const Candidate& pair : pairs) {
      if (pair == sequence[i]) continue;
      neighbours.push_back(sequence);
      neighbours.back()[i] = pair;
    }
  }
  return neighbours;
}

class ModeSearch {
 public:
  explicit ModeSearch(PhaseRun* run) : run_(*run), scene_(run->scene()), pairs_(AllPairs(scene_)) {}

  SolveReport Search(const ContactSequence& first) {
    best_loss_ = run_.guess().exact.loss;
    best_trial_ = run_.guess();
    const Flight guess = FlightOf(scene_, run_.guess());
    Queue(best_loss_, first, GuessFrom(scene_, guess, first));
    if (run_.options().search) QueueNeighbours(run_.guess());
    Termination end = Termination::kConverged;
    while (!queue_.empty()) {
      if (queue_.begin()->first.first > Bound()) break;
      if (solves_ >= run_.options().iterations) {
        end = Termination::kIterationLimit;
        break;
      }
      const auto next = queue_.extract(queue_.begin());
      SolveOne(next.key().first, next.mapped());
      if (!run_.Record(best_loss_)) {
        end = Termination::kInterrupted;
        break;
      }
    }
    return Report(end);
  }

 private:
  struct Task {
    ContactSequence sequence;
    PhaseGuess guess;
  };
  struct Found {
    LocalOptimum optimum;
    Trial trial;
  };

  double Bound() const { return kBound * std::abs(best_loss_); }

  void Queue(double priority, const ContactSequence& sequence, PhaseGuess guess) {
    if (sequence.size() > kMostImpacts || starts_[KeyOf(sequence)] >= kStarts) return;
    ++starts_[KeyOf(sequence)];
    queue_.emplace(std::pair(priority, number_++), Task{sequence, std::move(guess)});
  }

  void QueueNeighbours(const Trial& trial) {
    if (!trial.exact.only_impacts || trial.exact.loss > Bound()) return;
    const Flight flight = FlightOf(scene_, trial);
    for (const ContactSequence& neighbour : Neighbours(trial.exact.contacts, pairs_)) {
      Queue(trial.exact.loss, neighbour, GuessFrom(scene_, flight, neighbour));
    }
  }

  void SolveOne(double priority, const Task& task) {
    ++solves_;
    tried_.insert(KeyOf(task.sequence));
    PhaseMinimumOptions options;
    options.iterations = kMostIterations;
    options.callback = [&](double) { return Continue(); };
    const PhaseSolution solution = SolveAlong(scene_, task.sequence, task.guess, options, kLossChange);
    Say(task.sequence);
    if (!solution.valid || !solution.trial.exact.ok) return;
    Meet(solution.trial, solution.minimum.touches ? WhyNotOptimal(scene_, solution) : "");
    if (!solution.trial.exact.only_impacts) return;
    jacobians_ += solution.minimum.jacobians;
    if (solution.optimal() && !LeftAsSaddle(solution.trial)) Keep(solution);
    if (!run_.options().search) {
      if (!solution.optimal()) failure_ = WhyNotOptimal(scene_, solution);
      return;
    }
    const ContactSequence& met = solution.trial.exact.contacts;
    const double loss = solution.trial.exact.loss;
    if (met != task.sequence) {  // impacts have appeared or vanished: next in turn
      Queue(std::min(priority, loss), met, GuessFrom(scene_, FlightOf(scene_, solution.trial), met));
    }
    const double rounded = std::round(loss / (kSameLoss * best_loss_));
    if (expanded_.emplace(KeyOf(met), rounded).second) QueueNeighbours(solution.trial);
  }

  // A motion that is no optimum, or none yet, but may be better than all.
  void Meet(const Trial& trial, const std::string& remark) {
    if (!(trial.exact.loss < best_trial_.exact.loss)) return;
    best_trial_ = trial;
    best_remark_ = remark;
  }

  // If this stationary motion is a saddle, goes on from beside it.
  bool LeftAsSaddle(const Trial& trial) {
    const Certificate certificate = CertifyTrial(scene_, trial);
    if (!certificate.IsSaddle()) return false;
    const std::vector<Trial> aside = LeaveSaddle(scene_, trial, *certificate.curvature);
    for (const Trial& motion : aside) {
      Meet(motion, "");
      if (!motion.exact.only_impacts) continue;
      const ContactSequence& met = motion.exact.contacts;
      --starts_[KeyOf(met)];  // whatever it has been tried from
      Queue(motion.exact.loss, met, GuessFrom(scene_, FlightOf(scene_, motion), met));
    }
    return !aside.empty();
  }

  // Asks without recording an iteration.
  bool Continue() const {
    if (run_.options().stop && run_.options().stop()) return false;
    const auto& callback = run_.options().callback;
    return !callback || callback(static_cast<int>(run_.report().losses.size()) - 1, best_loss_);
  }

  void Keep(const PhaseSolution& solution) {
    Found found{{solution.sequence, solution.trial.exact.loss, {}}, solution.trial};
    for (const Event& event : solution.trial.exact.events) found.optimum.times.push_back(event.time);
    for (const Found& known : found_) {
      const double difference = std::abs(known.optimum.loss - found.optimum.loss);
      if (known.optimum.sequence == solution.sequence && difference <= kSameLoss * std::abs(found.optimum.loss)) return;
    }
    best_loss_ = std::min(best_loss_, found.optimum.loss);
    found_.push_back(std::move(found));
  }

  void Say(const ContactSequence& sequence) const {
    if (!run_.options().status) return;
    run_.options().status(std::to_string(solves_) + " sequences, best " +
                          std::to_string(ConvertLoss(best_loss_, scene_.units, {})) + ", now " +
                          ContactSequenceToString(scene_, sequence));
  }

  SolveReport Report(Termination end) {
    std::stable_sort(
        found_.begin(), found_.end(), [](const Found& a, const Found& b) { return a.optimum.loss < b.optimum.loss; });
    for (const Found& found : found_) run_.report().optima.push_back(found.optimum);
    run_.report().evaluations = jacobians_;
    const double none_better = (1 - kSameLoss) * (found_.empty() ? 0.0 : found_.front().optimum.loss);
    if (found_.empty() || best_trial_.exact.loss < none_better) {
      if (end == Termination::kConverged) end = Termination::kNoProgress;
      std::string reason = best_remark_.empty() ? failure_ : best_remark_;
      if (reason.empty())
        reason = found_.empty() ? "no sequence searched has an optimum" : "no optimum found is better";
      return run_.Finish(best_trial_, best_trial_.exact.loss, end, std::move(reason));
    }
    const Found& best = found_.front();
    Certificate certificate = CertifyTrial(scene_, best.trial);
    certificate.sequences_searched = static_cast<int>(tried_.size());
    if (run_.options().search && end != Termination::kInterrupted && !certificate.IsSaddle()) {
      certificate.scope = Certificate::Scope::kBestOfSearched;
    }
    run_.report().certificate = std::move(certificate);
    return run_.Finish(best.trial,
                       best.optimum.loss,
                       end,
                       "best of " + std::to_string(found_.size()) + " optima, along " +
                           ContactSequenceToString(scene_, best.optimum.sequence));
  }

  PhaseRun& run_;
  const Scene& scene_;
  ContactSequence pairs_;
  std::map<std::pair<double, int>, Task> queue_;  // by exact loss of the motion it comes from, then in order
  std::map<Key, int> starts_;                     // motions from which a sequence is, or is to be, tried
  std::set<Key> tried_;
  std::set<std::pair<Key, double>> expanded_;  // motions whose neighbours are queued: sequence and loss
  std::vector<Found> found_;
  Trial best_trial_;         // of all motions met, the guess included
  std::string best_remark_;  // why it is no optimum
  double best_loss_ = 0;
  int number_ = 0, solves_ = 0, jacobians_ = 0;
  std::string failure_;
};

}  // namespace

SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("mode_search", request, options);
  if (auto refused = run.WhyNotStart()) return *refused;
  return ModeSearch(&run).Search(SequenceFor(options, run.guess()));
}

}  // namespace saltus
