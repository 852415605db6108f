// Generated problems of identification: how often the estimates lie within their stated confidence, how often the
// parameters are found from a start 30 % off, and how long a fit takes. With --minutes, one long recording of a disc in
// a box instead, which is fitted in pieces.
#include <gflags/gflags.h>

#include <cstdio>
#include <ctime>
#include <fstream>

#include "identify/generated_problem.h"
#include "saltus/scene/scene_file.h"

DEFINE_int32(problems, 200, "how many");
DEFINE_int64(seed, 1, "of the first");
DEFINE_double(least_found, 0.95, "of all problems, exit code 1 below");
DEFINE_double(least_covered, 0.92, "share of 95 % intervals that hold, exit code 1 below");
DEFINE_double(most_covered, 0.97, "likewise, above");
DEFINE_bool(print, false, "every problem");
DEFINE_double(minutes, 0, "> 0: one recording of so long, 60 samples a second");
DEFINE_double(segment, 1, "s, of the pieces of that");
DEFINE_int32(threads, 2, "for it");
DEFINE_string(write, "", "folder for long.yaml and long.csv, of that recording, which then is not fitted here");

DEFINE_bool(coverage, false,
            "instead: the table of how often 95 % intervals hold, by number of samples and share of outliers, each of "
            "--problems problems");

DEFINE_int32(samples, 0, "of that table: only this number");
DEFINE_double(outliers, -1, "of that table: only this share");

namespace saltus {
namespace {

// How fits of so many samples went.
struct Coverage {
  int intervals = 0, covered = 0, fits = 0, contradicted = 0;
  int missed = 0;  // fits that end at a higher cost than that of the truth, and have missed the minimum
};

// The cost of the motion that made the samples, in the default loss. Precondition: they state their sigma.
double CostOfTruth(const GeneratedProblem& problem) {
  double cost = 0;
  for (const Sample& sample : problem.recording.samples) {
    const double miss = (BouncingBallAt(sample.time, problem.truth) - sample.position).norm() / sample.sigma;
    const double scale = IdentifyOptions().loss_scale;
    cost += miss < scale ? miss * miss / 2 : scale * (miss - scale / 2);
  }
  return cost;
}

Coverage CoverageOf(int samples, double outliers, bool states_sigma) {
  Coverage count;
  for (int i = 0; i < FLAGS_problems; ++i) {
    const GeneratedProblem problem = FewSamples(FLAGS_seed + i, samples, outliers, states_sigma);
    const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    const bool missed = states_sigma && report.cost > CostOfTruth(problem);
    count.missed += missed;
    count.fits += report.verdict == FitVerdict::kFits;
    count.contradicted += report.verdict == FitVerdict::kContradicted;
    if (FLAGS_print) {
      int named = 0, right = 0;  // outliers
      for (const SampleResidual& at : report.residuals) {
        named += at.outlier;
        right += at.outlier && problem.outlier[at.sample];
      }
      std::printf("seed %lld, %d wrong, %d of %d outliers: %s %s, misfit %.3f, sigma %.3g, cost %.4g, %d starts%s\n",
                  static_cast<long long>(FLAGS_seed + i),
                  static_cast<int>(std::ranges::count(problem.outlier, true)),
                  right,
                  named,
                  FitVerdictToString(report.verdict),
                  report.reason.c_str(),
                  report.misfit,
                  report.sigma,
                  report.cost,
                  report.starts,
                  missed ? ", missed the minimum" : "");
    }
    for (const Estimate& estimate : report.estimates) {
      const double truth = TrueValue(problem, estimate.unknown);
      if (FLAGS_print) {
        std::printf("  %s %s %.5f +- %.5f [%.5f %.5f], true %.5f%s\n",
                    estimate.name.c_str(),
                    DeterminationToString(estimate.determination),
                    estimate.value,
                    estimate.standard_error,
                    estimate.low,
                    estimate.high,
                    truth,
                    truth >= estimate.low && truth <= estimate.high ? "" : " *");
      }
      if (estimate.determination != Determination::kDetermined || report.verdict != FitVerdict::kFits) continue;
      ++count.intervals;
      count.covered += truth >= estimate.low && truth <= estimate.high;
    }
  }
  return count;
}

int MeasureCoverage() {
  std::printf(
      "| samples | outliers | sigma | fits | contradicted | missed | intervals | hold "
      "|\n|---|---|---|---|---|---|---|---|\n");
  for (const int samples : {6, 8, 12, 20, 40, 60}) {
    for (const double outliers : {0.0, 0.1, 0.25}) {
      if (FLAGS_samples > 0 && samples != FLAGS_samples) continue;
      if (FLAGS_outliers >= 0 && outliers != FLAGS_outliers) continue;
      for (const bool states_sigma : {true, false}) {
        const Coverage count = CoverageOf(samples, outliers, states_sigma);
        std::printf("| %d | %.0f %% | %s | %d | %d | %d | %d | %.1f %% |\n",
                    samples,
                    100 * outliers,
                    states_sigma ? "stated" : "estimated",
                    count.fits,
                    count.contradicted,
                    count.missed,
                    count.intervals,
                    100.0 * count.covered / std::max(1, count.intervals));
        std::fflush(stdout);
      }
    }
  }
  return 0;
}

struct Tally {
  int found = 0, intervals = 0, covered = 0, open = 0, impacts = 0;
  double seconds = 0, slowest = 0;
};

void Run(uint64_t seed, Tally* tally) {
  const GeneratedProblem problem = GenerateProblem(seed);
  const std::clock_t begin = std::clock();  // CPU time, as the machine may have other work
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
  const double seconds = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
  bool found = report.verdict == FitVerdict::kFits;
  for (const Estimate& estimate : report.estimates) {
    if (estimate.determination != Determination::kDetermined) {
      ++tally->open;
      continue;
    }
    const double truth = TrueValue(problem, estimate.unknown);
    const bool covered = truth >= estimate.low && truth <= estimate.high;
    ++tally->intervals;
    tally->covered += covered;
    // Far outside of its confidence: another minimum.
    found = found && std::abs(estimate.value - truth) < 6 * estimate.standard_error + 1e-9;
    if (FLAGS_print) {
      std::printf("  %s %.5f +- %.5f, true %.5f%s\n",
                  estimate.name.c_str(),
                  estimate.value,
                  estimate.standard_error,
                  truth,
                  covered ? "" : " *");
    }
  }
  tally->found += found;
  tally->impacts += problem.impacts;
  tally->seconds += seconds;
  tally->slowest = std::max(tally->slowest, seconds);
  if (FLAGS_print || !found) {
    std::printf("seed %llu: %s, %d discs, %d impacts, misfit %.3f, cost %.4g, %d starts, %d iterations, %.0f ms %s\n",
                static_cast<unsigned long long>(seed),
                FitVerdictToString(report.verdict),
                problem.truth.num_bodies(),
                problem.impacts,
                report.misfit,
                report.cost,
                report.starts,
                report.iterations,
                1e3 * seconds,
                report.reason.c_str());
  }
}

// For saltus_identify.
int Write(const GeneratedProblem& problem) {
  std::ofstream(FLAGS_write + "/long.yaml") << WriteScene(problem.guess);
  std::ofstream csv(FLAGS_write + "/long.csv");
  csv.precision(17);
  csv << "time,body,x,y,sigma\n";
  for (const Sample& sample : problem.recording.samples) {
    csv << sample.time << "," << problem.guess.bodies[sample.body].name << "," << sample.position[0] << ","
        << sample.position[1] << "," << sample.sigma << "\n";
  }
  return csv.good() ? 0 : 1;
}

int FitLongRecording() {
  const GeneratedProblem problem = LongProblem(60 * FLAGS_minutes);
  if (!FLAGS_write.empty()) return Write(problem);
  IdentifyOptions options{.segment = FLAGS_segment, .threads = FLAGS_threads};
  if (FLAGS_print) options.status = [](const std::string& what) { std::fprintf(stderr, "%s\n", what.c_str()); };
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns, options);
  const Estimate& estimate = report.estimates.at(0);
  std::printf(
      "%zu samples, %zu segments, %d impacts: %s, restitution %.6f +- %.6f, true %.6f; %d iterations, %.1f s %s\n",
      problem.recording.samples.size(),
      report.initial.size(),
      report.impacts,
      FitVerdictToString(report.verdict),
      estimate.value,
      estimate.standard_error,
      problem.truth.contact.restitution,
      report.iterations,
      report.seconds,
      report.reason.c_str());
  const bool found = std::abs(estimate.value - problem.truth.contact.restitution) < 5 * estimate.standard_error;
  return report.verdict == FitVerdict::kFits && found ? 0 : 1;
}

int Main() {
  if (FLAGS_minutes > 0) return FitLongRecording();
  if (FLAGS_coverage) return MeasureCoverage();
  Tally tally;
  for (int i = 0; i < FLAGS_problems; ++i) Run(FLAGS_seed + i, &tally);
  const double found = double(tally.found) / FLAGS_problems, covered = double(tally.covered) / tally.intervals;
  std::printf(
      "%d problems, %d impacts: found %.3f, 95 %% intervals hold %.3f of %d, %d not determined, "
      "%.1f ms on average, at most %.1f ms\n",
      FLAGS_problems,
      tally.impacts,
      found,
      covered,
      tally.intervals,
      tally.open,
      1e3 * tally.seconds / FLAGS_problems,
      1e3 * tally.slowest);
  return found >= FLAGS_least_found && covered >= FLAGS_least_covered && covered <= FLAGS_most_covered ? 0 : 1;
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  gflags::ParseCommandLineFlags(&argc, &argv, true);
  return saltus::Main();
}
