#include "programs/sweep.h"

#include <gflags/gflags.h>

#include <cmath>
#include <iostream>
#include <limits>
#include <sstream>

#include "programs/parallel.h"
#include "programs/solve.h"
#include "saltus/audit/audit.h"

DEFINE_string(sweep, "", "axes of the grid: 'stiffness=1e2:1e5:log:7;steps=120,240,480'");

namespace saltus {
namespace {

struct Option {
  const char* name;
  bool integer;
  void (*set)(double value, Request* request);
};

constexpr Option kOptions[] = {
    {"stiffness", false, [](double value, Request* r) { r->scene.contact.stiffness = value; }},
    {"damping", false, [](double value, Request* r) { r->scene.contact.damping = value; }},
    {"restitution", false, [](double value, Request* r) { r->scene.contact.restitution = value; }},
    {"friction", false, [](double value, Request* r) { r->scene.contact.friction = value; }},
    {"steps", true, [](double value, Request* r) { r->scene.steps = static_cast<int>(value); }},
    {"duration", false, [](double value, Request* r) { r->scene.duration = value; }},
    {"gravity_x", false, [](double value, Request* r) { r->scene.gravity[0] = value; }},
    {"gravity_y", false, [](double value, Request* r) { r->scene.gravity[1] = value; }},
    {"effort", false, [](double value, Request* r) { r->scene.objective.effort = value; }},
    {"learning_rate", false, [](double value, Request* r) { r->options.learning_rate = value; }},
    {"iterations", true, [](double value, Request* r) { r->options.iterations = static_cast<int>(value); }},
};

std::vector<std::string> Split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::stringstream stream(text);
  for (std::string part; std::getline(stream, part, separator);) parts.push_back(part);
  return parts;
}

double ParseNumber(const std::string& text, const std::string& axis) {
  size_t used = 0;
  double value = 0;
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  if (used == 0 || used != text.size() || !std::isfinite(value)) {
    throw InputError("--sweep: in '" + axis + "', '" + text + "' is not a number");
  }
  return value;
}

std::vector<double> ParseValues(const std::string& text, const std::string& axis) {
  const std::vector<std::string> range = Split(text, ':');
  std::vector<double> values;
  if (range.size() == 1) {
    for (const std::string& item : Split(text, ',')) values.push_back(ParseNumber(item, axis));
  } else {
    if (range.size() != 4 || (range[2] != "lin" && range[2] != "log")) {
      throw InputError("--sweep: '" + axis + "' has a range that is not first:last:lin:count or first:last:log:count");
    }
    const double first = ParseNumber(range[0], axis);
    const double last = ParseNumber(range[1], axis);
    const double count = ParseNumber(range[3], axis);
    if (count < 1 || count > 1e6 || count != std::floor(count)) {
      throw InputError("--sweep: '" + axis + "' has a count that is not a whole number in 1..1000000");
    }
    const bool log = range[2] == "log";
    if (log && !(first > 0 && last > 0))
      throw InputError("--sweep: '" + axis + "' is logarithmic; its ends must be > 0");
    for (int i = 0; i < count; ++i) {
      const double t = count > 1 ? i / (count - 1) : 0.0;
      if (i + 1 == count && count > 1) {
        values.push_back(last);
      } else {
        values.push_back(log ? first * std::pow(last / first, t) : first + t * (last - first));
      }
    }
  }
  if (values.empty()) throw InputError("--sweep: '" + axis + "' has no values");
  return values;
}

const Option* FindOption(const std::string& name) {
  for (const Option& option : kOptions) {
    if (name == option.name) return &option;
  }
  return nullptr;
}

std::string KnownOptions() {
  std::string names;
  for (const std::string& name : SweepOptions()) names += (names.empty() ? "" : ", ") + name;
  return names;
}

struct Point {
  std::vector<double> values;
  std::string contact, solver;  // no solver: evaluate only
};

std::vector<Point> Grid(const Request& request, const std::vector<SweepAxis>& axes) {
  std::vector<Point> points = {{}};
  for (const SweepAxis& axis : axes) {
    std::vector<Point> next;
    for (const Point& point : points) {
      for (double value : axis.values) {
        next.push_back(point);
        next.back().values.push_back(value);
      }
    }
    points = std::move(next);
  }
  std::vector<Point> all;
  const std::vector<std::string> solvers = request.solvers.empty() ? std::vector<std::string>{""} : request.solvers;
  for (const Point& point : points) {
    for (const std::string& contact : request.contacts) {
      for (const std::string& solver : solvers) all.push_back({point.values, contact, solver});
    }
  }
  return all;
}

std::optional<double> NumberOrEmpty(double value) { return std::isfinite(value) ? std::optional(value) : std::nullopt; }

// The result columns of one point, after the values of the axes.
std::vector<Cell> SolveRow(const Request& request, const Point& point) {
  const SolveReport report = Solve(point.solver, {request.scene, point.contact, request.precision}, request.options);
  std::vector<Cell> row = {point.contact, point.solver};
  if (report.losses.empty()) {
    row.insert(row.end(), 7, Cell());
  } else {
    const ExactRun exact = SimulateExactly(request.scene, report.initial_state, report.control, report.durations);
    const size_t count = report.losses.size();
    row.insert(row.end(),
               {NumberOrEmpty(report.initial_loss),
                NumberOrEmpty(count > 1 ? report.losses[count - 2] : report.losses[0]),
                NumberOrEmpty(report.final_loss),
                NumberOrEmpty(exact.ok ? exact.loss : std::numeric_limits<double>::quiet_NaN()),
                report.iterations,
                report.evaluations,
                report.seconds});
  }
  row.push_back(TerminationToString(report.termination));
  row.push_back(report.reason);
  return row;
}

double NormOf(const std::vector<double>& initial, int offset) {
  double sum = 0;
  for (size_t i = 0; i < initial.size(); i += 4)
    sum += std::pow(initial[i + offset], 2) + std::pow(initial[i + offset + 1], 2);
  return std::sqrt(sum);
}

std::vector<Cell> GradientRow(const Request& request, const Point& point) {
  const ModelGradient gradient = ComputeGradient(point.contact, request.scene, request.precision);
  if (!gradient.ok()) return {point.contact, "", "", "", "", "", gradient.reason};
  double control = 0;
  for (double value : gradient.gradient.control) control += value * value;
  Cell error("");
  if (const std::optional<ModelGradient> exact = ExactGradientOf(request.scene)) {
    error = NumberOrEmpty(CompareGradients(gradient, *exact).relative);
  }
  return {point.contact,
          NumberOrEmpty(gradient.loss),
          NumberOrEmpty(NormOf(gradient.gradient.initial, 0)),
          NumberOrEmpty(NormOf(gradient.gradient.initial, 2)),
          NumberOrEmpty(std::sqrt(control)),
          error,
          ""};
}

std::vector<Cell> FailedRow(const Point& point, const std::string& reason, size_t width) {
  std::vector<Cell> row(width, Cell());
  row[0] = point.contact;
  if (!point.solver.empty()) {
    row[1] = point.solver;
    row[width - 2] = TerminationToString(Termination::kFailed);
  }
  row[width - 1] = reason;
  return row;
}

}  // namespace

std::vector<std::string> SweepOptions() {
  std::vector<std::string> names;
  for (const Option& option : kOptions) names.emplace_back(option.name);
  return names;
}

std::vector<SweepAxis> ParseSweep(const std::string& text) {
  std::vector<SweepAxis> axes;
  for (const std::string& axis : Split(text, ';')) {
    const size_t equals = axis.find('=');
    if (equals == std::string::npos) throw InputError("--sweep: '" + axis + "' is not of the form option=values");
    const std::string name = axis.substr(0, equals);
    const Option* option = FindOption(name);
    if (option == nullptr)
      throw InputError("--sweep: '" + name + "' is not an option; expected one of " + KnownOptions());
    for (const SweepAxis& other : axes) {
      if (other.option == name) throw InputError("--sweep: '" + name + "' is given twice");
    }
    axes.push_back({name, ParseValues(axis.substr(equals + 1), axis)});
    for (double& value : axes.back().values) {
      if (!option->integer) continue;
      value = std::round(value);
      if (std::abs(value) > 1e9) throw InputError("--sweep: '" + axis + "' goes beyond 1e9");
    }
  }
  if (axes.empty()) throw InputError("--sweep is empty; expected for example --sweep=\"stiffness=1e2:1e5:log:4\"");
  return axes;
}

void SetSweepOption(const std::string& name, double value, Request* request) {
  const Option* option = FindOption(name);
  if (option == nullptr) throw InputError("'" + name + "' is not an option; expected one of " + KnownOptions());
  option->set(value, request);
  if (request->options.iterations < 0) throw InputError("iterations must not be negative");
  if (!(request->options.learning_rate > 0)) throw InputError("learning_rate must be positive");
}

Table RunSweep(const Request& request, const std::vector<SweepAxis>& axes) {
  const bool solving = !request.solvers.empty();
  std::vector<Column> columns;
  for (const SweepAxis& axis : axes) columns.push_back({axis.option, 8});
  const std::vector<Column> results = solving ? std::vector<Column>{{"contact"},
                                                                    {"solver"},
                                                                    {"initial_loss", 10},
                                                                    {"loss_before_last", 10},
                                                                    {"final_loss", 10},
                                                                    {"exact_loss", 10},
                                                                    {"iterations"},
                                                                    {"evaluations"},
                                                                    {"seconds", 3},
                                                                    {"termination"},
                                                                    {"reason"}}
                                              : std::vector<Column>{{"contact"},
                                                                    {"loss", 10},
                                                                    {"norm_dposition", 8},
                                                                    {"norm_dvelocity", 8},
                                                                    {"norm_dcontrol", 8},
                                                                    {"relative_error", 4},
                                                                    {"reason"}};
  columns.insert(columns.end(), results.begin(), results.end());

  const std::vector<Point> points = Grid(request, axes);
  std::vector<std::vector<Cell>> rows(points.size());
  const InterruptGuard guard;
  Progress progress(request.progress, stderr, "sweep " + request.scene.name, points.size());
  RunJobs(points.size(), request.threads, &progress, [&](int i) {
    const Point& point = points[i];
    Request local = request;
    std::string reason;
    try {
      for (size_t a = 0; a < axes.size(); ++a) SetSweepOption(axes[a].option, point.values[a], &local);
      if (const std::optional<SceneError> error = Validate(local.scene)) reason = error->key + ": " + error->message;
    } catch (const InputError& error) {
      reason = error.what();
    }
    std::vector<Cell> result;
    if (!reason.empty()) {
      result = FailedRow(point, reason, results.size());
    } else {
      local.options.callback = [](int, double) { return !InterruptGuard::Interrupted(); };
      result = solving ? SolveRow(local, point) : GradientRow(local, point);
    }
    rows[i].assign(point.values.begin(), point.values.end());
    rows[i].insert(rows[i].end(), result.begin(), result.end());
  });

  Table table(columns);
  for (std::vector<Cell>& row : rows) {
    if (!row.empty()) table.AddRow(std::move(row));
  }
  return table;
}

int SweepMain(int argc, char** argv) {
  return RunMain(argc,
                 argv,
                 "Every combination of numeric options: saltus_sweep --scene=FILE --sweep=\"stiffness=1e2:1e5:log:7;"
                 "steps=120,240\" [--contact=LIST] [--solver=LIST|none]. CSV on stdout.",
                 [] {
                   Request request;
                   if (!ReadRequest({}, &request)) return kDone;
                   const Table table = RunSweep(request, ParseSweep(FLAGS_sweep));
                   std::cout << table.ToCsv() << std::flush;
                   if (!request.output_dir.empty()) WriteTextFile(request.output_dir + "/sweep.csv", table.ToCsv());
                   return InterruptGuard::Interrupted() ? kAnswerFailed : kDone;
                 });
}

}  // namespace saltus
