// Tables (Markdown) and figures from the JSON output of the benchmarks.
//
// usage: bench_report OUTPUT_DIR RESULTS.json...
#include <glog/logging.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "base/file.h"
#include "output/page.h"

namespace saltus {
namespace {

using Json = nlohmann::json;

// A benchmark's name in parts: "Steps/event/480/iterations:1/manual_time" is {"Steps", "event", "480"}.
std::vector<std::string> Parts(const std::string& name) {
  std::vector<std::string> parts;
  std::stringstream stream(name);
  for (std::string part; std::getline(stream, part, '/');) {
    const size_t first = part.find_first_not_of(' ');
    if (first == std::string::npos || part.find(':') != std::string::npos || part == "manual_time" ||
        part == "real_time") {
      continue;
    }
    parts.push_back(part.substr(first, part.find_last_not_of(' ') + 1 - first));
  }
  return parts;
}

struct Result {
  std::vector<std::string> parts;
  Json values;

  double operator[](const char* counter) const { return values.at(counter).get<double>(); }
};

std::string Number(double value, const char* format = "%.3g") {
  char text[32];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

// The largest by the least.
double Spread(const std::vector<double>& values) {
  const auto [least, largest] = std::minmax_element(values.begin(), values.end());
  return *largest / *least;
}

std::string ProcessorName() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
  }
  return "unknown processor";
}

class Report {
 public:
  void Add(const Json& document) {
    context_ = document.at("context");
    for (const Json& benchmark : document.at("benchmarks")) {
      if (benchmark.value("error_occurred", false)) continue;
      results_.push_back({Parts(benchmark.at("name").get<std::string>()), benchmark});
    }
  }

  std::string Markdown() const {
    std::ostringstream out;
    WriteMachine(&out);
    WriteGradients(&out);
    WriteGrowth("Steps", "steps", "Two balls, per step", &out);
    WriteGrowth("Bodies", "discs", "Gas in a box at fixed density, per disc and step", &out);
    WriteThroughput(&out);
    WriteIterations(&out);
    WriteSolvers(&out);
    WriteTimesToSolution(&out);
    return out.str();
  }

  Page GrowthPage() const {
    Page page("Benchmarks");
    page.AddFigure({.panels = {GrowthPanel("Steps", "steps", "per step (ns)"),
                               GrowthPanel("Bodies", "discs", "per disc and step (ns)")}},
                   "Time of a rollout (dashed) and of its loss with gradient (solid).");
    return page;
  }

 private:
  std::vector<Result> ResultsOf(const std::string& kind) const {
    std::vector<Result> found;
    for (const Result& result : results_) {
      if (!result.parts.empty() && result.parts[0] == kind) found.push_back(result);
    }
    return found;
  }

  void WriteMachine(std::ostream* out) const {
    *out << ProcessorName() << ", " << context_.at("num_cpus") << " cores";
    for (const Json& cache : context_.at("caches")) {
      if (cache.at("type") != "Instruction") {
        *out << ", L" << cache.at("level") << " " << cache.at("size").get<long>() / 1024 << " KiB";
      }
    }
    *out << "; GCC " << __VERSION__ << ", " << context_.at("date").get<std::string>().substr(0, 10) << ".\n\n";
  }

  void WriteGradients(std::ostream* out) const {
    *out << "Two balls, 480 steps, 960 controls, one core:\n\n"
            "| contact model | rollout and loss (us) | with gradient (us) | ratio | rollout, `direct` = 1 |\n"
            "|---|---|---|---|---|\n";
    const std::vector<Result> results = ResultsOf("Gradient");
    const auto direct =
        std::find_if(results.begin(), results.end(), [](const Result& r) { return r.parts[1] == "direct"; });
    for (const Result& result : results) {
      const std::string name = result.parts[1] == "by_hand" ? "(direct_toi written by hand)" : result.parts[1];
      *out << "| " << name << " | " << Number(result["forward_us"]) << " | " << Number(result["gradient_us"]) << " | "
           << Number(result["gradient_by_forward"], "%.2f") << " | "
           << (direct == results.end() ? "" : Number(result["forward_us"] / (*direct)["forward_us"], "%.2f")) << " |\n";
    }
    *out << "\n";
  }

  void WriteGrowth(const std::string& kind, const std::string& unit, const std::string& title,
                   std::ostream* out) const {
    *out << title << ", rollout / with gradient (ns):\n\n| contact model |";
    std::vector<std::string> names, sizes;
    std::map<std::pair<std::string, std::string>, Result> cells;
    for (const Result& result : ResultsOf(kind)) {
      if (std::find(names.begin(), names.end(), result.parts[1]) == names.end()) names.push_back(result.parts[1]);
      if (std::find(sizes.begin(), sizes.end(), result.parts[2]) == sizes.end()) sizes.push_back(result.parts[2]);
      cells[{result.parts[1], result.parts[2]}] = result;
    }
    for (const std::string& size : sizes) *out << " " << size << " " << unit << " |";
    *out << " largest by least |\n|---|---|";
    for (size_t i = 0; i < sizes.size(); ++i) *out << "---|";
    *out << "\n";
    for (const std::string& name : names) {
      *out << "| " << name << " |";
      std::vector<double> forward, gradient;
      for (const std::string& size : sizes) {
        const Result& cell = cells.at({name, size});
        forward.push_back(cell["forward_ns"]);
        gradient.push_back(cell["gradient_ns"]);
        *out << " " << Number(forward.back()) << " / " << Number(gradient.back()) << " |";
      }
      *out << " " << Number(Spread(forward), "%.2f") << " / " << Number(Spread(gradient), "%.2f") << " |\n";
    }
    *out << "\n";
  }

  void WriteThroughput(std::ostream* out) const {
    *out << "Batches of gradients (two balls, 480 steps), by threads:\n\n"
            "| contact model | threads | gradients per second | speed-up |\n|---|---|---|---|\n";
    std::map<std::string, double> single;
    for (const Result& result : ResultsOf("Throughput")) {
      const double rate = result["gradients_per_second"];
      if (result.parts[2] == "1") single[result.parts[1]] = rate;
      *out << "| " << result.parts[1] << " | " << result.parts[2] << " | " << Number(rate, "%.0f") << " | "
           << Number(rate / single.at(result.parts[1]), "%.2f") << " |\n";
    }
    *out << "\n";
  }

  void WriteIterations(std::ostream* out) const {
    *out << "One iteration of a solver, in gradients of the same problem:\n\n"
            "| solver | contact model | problem | steps | iteration | set-up |\n|---|---|---|---|---|---|\n";
    for (const Result& result : ResultsOf("Iteration")) {
      for (int i = 1; i <= 4; ++i) *out << "| " << result.parts[i] << " ";
      *out << "| " << Number(result["gradients_per_iteration"]) << " | " << Number(result["setup_in_gradients"])
           << " |\n";
    }
    *out << "\n";
  }

  void WriteSolvers(std::ostream* out) const {
    *out << "To the solution, until the loss is within 1 % of the best that the solver reaches:\n\n"
            "| solver | contact model | problem | time (ms) | iterations |\n|---|---|---|---|---|\n";
    for (const Result& result : ResultsOf("Solution")) {
      *out << "| " << result.parts[1] << " | " << result.parts[2] << " | " << result.parts[3] << " | "
           << Number(result["milliseconds"]) << " | " << Number(result["iterations_needed"], "%.0f") << " |\n";
    }
    *out << "\n";
  }

  void WriteTimesToSolution(std::ostream* out) const {
    *out << "Two balls, from the scene to the solution under exact dynamics (gap: exact loss less the optimum):\n\n"
            "| solver | steps | time (ms) | iterations | gap |\n|---|---|---|---|---|\n";
    for (const Result& result : ResultsOf("TimeToSolution")) {
      *out << "| " << result.parts[1] << " | " << result.parts[2] << " | " << Number(result["cpu_time"]) << " | "
           << Number(result["iterations_needed"], "%.0f") << " | " << Number(result["gap"], "%.2g") << " |\n";
    }
    *out << "\n";
  }

  Panel GrowthPanel(const std::string& kind, const std::string& unit, const std::string& quantity) const {
    Panel panel;
    panel.x.label = unit;
    panel.y.label = quantity;
    panel.x.log = panel.y.log = true;
    std::map<std::string, std::pair<Series, Series>> lines;
    for (const Result& result : ResultsOf(kind)) {
      const std::string& name = result.parts[1];
      const auto [at, added] = lines.try_emplace(name);
      auto& [forward, gradient] = at->second;
      if (added) {
        forward = Series::ForModel(name, {}, {});
        gradient = forward;
        forward.dash = Dash::kDashed;
        gradient.dash = Dash::kSolid;
      }
      for (Series* series : {&forward, &gradient}) series->x.push_back(std::stod(result.parts[2]));
      forward.y.push_back(result["forward_ns"]);
      gradient.y.push_back(result["gradient_ns"]);
    }
    for (const auto& [name, pair] : lines) panel.series.insert(panel.series.end(), {pair.second, pair.first});
    return panel;
  }

  Json context_;
  std::vector<Result> results_;
};

int Main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: bench_report OUTPUT_DIR RESULTS.json...\n");
    return 2;
  }
  const std::string directory = argv[1];
  Report report;
  for (int i = 2; i < argc; ++i) {
    std::ifstream file(argv[i]);
    report.Add(Json::parse(file));
  }
  for (const Status& status :
       {WriteFile(directory + "/bench.md", report.Markdown()), report.GrowthPage().Write(directory + "/bench.html")}) {
    if (status.ok()) continue;
    std::fprintf(stderr, "error: %s\n", status.message().c_str());
    return 1;
  }
  std::printf("%s", report.Markdown().c_str());
  return 0;
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) { return saltus::Main(argc, argv); }
