#include <algorithm>
#include <cmath>
#include <map>

#include "base/csv.h"
#include "base/number_text.h"
#include "exact/closed_forms.h"
#include "exact/two_disc_optimum.h"
#include "paper/experiments.h"

namespace saltus {
namespace {

double ToNumber(const std::string& text, const std::string& where) {
  if (const std::optional<double> number = FromText<double>(text)) return *number;
  throw InputError(where + ": '" + text + "' is not a number");
}

// The place of a quantity such as "dloss/dp2_x" in a gradient: body (from 0), entry of [p_x p_y v_x v_y], or force.
struct Component {
  bool control = false;
  int body = 0;
  int entry = 0;
};

std::optional<Component> ParseComponent(const std::string& quantity) {
  static const std::map<std::string, Component> kComponents = {{"dloss/dp_y", {false, 0, 1}},
                                                               {"dloss/dv_x", {false, 0, 2}},
                                                               {"dloss/dv_y", {false, 0, 3}},
                                                               {"dloss/du0_y", {true, 0, 1}},
                                                               {"dloss/dp1_x", {false, 0, 0}},
                                                               {"dloss/dp2_x", {false, 1, 0}},
                                                               {"dloss/dv1_x", {false, 0, 2}},
                                                               {"dloss/dv2_x", {false, 1, 2}},
                                                               {"dloss/du1_0_x", {true, 0, 0}}};
  const auto found = kComponents.find(quantity);
  if (found == kComponents.end()) return std::nullopt;
  return found->second;
}

double ValueOf(const Sensitivity& gradient, const Component& component) {
  return component.control ? gradient.control[component.entry] : gradient.initial[4 * component.body + component.entry];
}

// Returns the exact derivative. A force of a Brax model acts for two steps of the grid, so two exact ones are added.
double ExactValueOf(const ModelGradient& exact, const Component& component, int num_steps) {
  if (!component.control) return ValueOf(exact.gradient, component);
  double sum = 0;
  for (int k = 0; k < exact.num_steps / num_steps; ++k) sum += exact.gradient.control[2 * k + component.entry];
  return sum;
}

std::optional<double> LearnedValue(const Experiment& experiment, const std::string& quantity) {
  if (quantity == "initial_loss") return experiment.gradient.loss;
  const CheckedRun* run = experiment.Find("gd");
  if (run == nullptr) return std::nullopt;
  if (quantity == "loss_999" && run->report.history.losses.size() > 999) return run->report.history.losses[999];
  if (quantity == "v_x_1000") return run->report.solution.initial_state[2];
  if (quantity == "v_y_1000") return run->report.solution.initial_state[3];
  return std::nullopt;
}

void FillAnalytic(const Experiments& experiments, PublishedRow* row) {
  if (row->quantity == "optimal_loss") {
    const TwoDiscSequence sequence =
        row->problem == "multiple_collisions" ? TwoDiscSequence::kImpactThenPlane : TwoDiscSequence::kImpact;
    if (const auto optimum = FindTwoDiscOptimum(experiments.scene(row->problem), sequence)) {
      row->ours = row->exact = optimum->loss;
    }
    return;
  }
  const std::optional<ClosedForm> closed_form = EvaluateClosedForm(experiments.scene(row->problem));
  const std::optional<Component> component = ParseComponent(row->quantity);
  if (!closed_form || !component) return;
  const ExactGradient& gradient = closed_form->gradient;
  if (component->control) {
    row->ours = gradient.control[0][0][component->entry];
  } else {
    const std::vector<Vec2d>& vectors = component->entry < 2 ? gradient.position : gradient.velocity;
    row->ours = vectors[component->body][component->entry % 2];
  }
  row->exact = row->ours;
}

void Fill(const Experiments& experiments, PublishedRow* row) {
  if (row->contact == "analytic") return FillAnalytic(experiments, row);
  const Experiment* experiment = experiments.Find(row->problem, row->friction, row->contact, row->precision);
  const Experiment* exact = experiments.Exact(row->problem, row->friction);
  if (experiment == nullptr || !experiment->gradient.ok()) return;
  if (const std::optional<Component> component = ParseComponent(row->quantity)) {
    row->ours = ValueOf(experiment->gradient.gradient, *component);
    if (exact != nullptr) row->exact = ExactValueOf(exact->gradient, *component, experiment->gradient.num_steps);
  } else {
    row->ours = LearnedValue(*experiment, row->quantity);
    if (exact != nullptr) row->exact = LearnedValue(*exact, row->quantity);
  }
}

// Returns "∂loss/∂p1_x" for "dloss/dp1_x", and "v_x after 1000 updates" for "v_x_1000".
std::string HeaderOf(const std::string& quantity) {
  if (quantity.starts_with("dloss/d")) return "∂loss/∂" + quantity.substr(7);
  if (quantity == "initial_loss") return "initial loss";
  if (quantity == "optimal_loss") return "optimal loss";
  const size_t last = quantity.rfind('_');
  return quantity.substr(0, last) + " after " + quantity.substr(last + 1) + " updates";
}

// Returns a number with as many decimals as the published one has.
std::string WithPublishedDecimals(double value, const PublishedRow& row) {
  const size_t point = row.published.find('.');
  const size_t decimals = point == std::string::npos ? 5 : row.published.size() - point - 1;
  return Format(("%." + std::to_string(decimals) + "f").c_str(), value);
}

}  // namespace

bool PublishedRow::Matches() const { return ours && std::abs(*ours - expected) <= tolerance; }

std::vector<PublishedRow> ReadPublished(const std::string& path) {
  const StatusOr<CsvDocument> csv = ReadCsv(path);
  if (!csv.ok()) throw InputError(csv.status().message());
  std::vector<PublishedRow> rows;
  for (size_t i = 0; i < csv->rows.size(); ++i) {
    const auto cell = [&](const char* column) -> const std::string& {
      const std::optional<size_t> index = csv->Find(column);
      if (!index) throw InputError(path + ": no column '" + column + "'");
      return csv->rows[i][*index];
    };
    const std::string where = path + ", row " + std::to_string(i + 1);
    PublishedRow row;
    row.table = cell("table");
    row.problem = cell("problem");
    row.friction = ToNumber(cell("friction"), where);
    row.contact = cell("contact");
    row.precision = cell("precision") == "float" ? Precision::kFloat : Precision::kDouble;
    row.quantity = cell("quantity");
    row.published = cell("published");
    row.expected = ToNumber(cell("expected"), where);
    row.tolerance = ToNumber(cell("tolerance"), where);
    row.verdict = cell("verdict");
    row.note = cell("note");
    rows.push_back(std::move(row));
  }
  return rows;
}

void CompareWithPublished(const Experiments& experiments, std::vector<PublishedRow>* rows) {
  for (PublishedRow& row : *rows) Fill(experiments, &row);
}

std::vector<std::pair<std::string, std::string>> PublishedTables() {
  return {{"T1", "Table 1 of the paper: gradients of the final height of a ball that bounces once"},
          {"T2", "Table 2 of the paper: gradients and learned velocity, ball off ground and wall, no friction"},
          {"T3", "Table 3 of the paper: gradients and learned loss, two balls"},
          {"T4", "Table 4 of the paper: gradients and learned velocity, ball off ground and wall, friction 0.1"},
          {"F5", "Stiffness of the compliant model, two balls"},
          {"L4DC", "Optima of the follow-up paper"}};
}

std::string VerdictInWords(const PublishedRow& row) {
  if (!row.IsJudged()) return "not judged: rounding decides it";
  const std::string start = row.Matches() ? "as expected" : "NOT as expected";
  if (row.verdict == "match") return row.Matches() ? "reproduced" : "NOT reproduced";
  if (row.verdict.empty()) return start + "; none is printed";
  if (row.verdict == "approximate") return start + "; the published number is approximate";
  if (row.verdict == "grid") return start + "; the published number is the lowest of a grid of points";
  if (row.verdict == "published_misprint") return start + "; the published number is a misprint";
  if (row.verdict == "published_error") return start + "; the published number is that of another quantity";
  if (row.verdict == "published_unreproducible") return start + "; the released code gives another number";
  if (row.verdict == "solver_error") return start + "; the published number has the error of its solver";
  return start + "; " + row.verdict;
}

Table ToTable(const std::vector<PublishedRow>& rows, const std::string& name) {
  Table table(ColumnsOf("contact; quantity; precision; published; ours:9; exact:9; verdict; why"));
  for (const PublishedRow& row : rows) {
    if (row.table != name) continue;
    const bool as_printed = row.verdict.empty() || row.verdict == "match";
    const bool missed = row.IsJudged() && !row.Matches();
    Cell verdict(VerdictInWords(row));
    verdict.WithTone(missed ? Tone::kBad : as_printed ? Tone::kGood : Tone::kWarning);
    table.AddRow({row.contact,
                  row.quantity,
                  row.precision == Precision::kFloat ? "float" : "double",
                  row.published,
                  row.ours,
                  row.exact,
                  verdict,
                  row.note});
  }
  return table;
}

Table PaperTable(const std::vector<PublishedRow>& rows, const std::string& name, std::vector<std::string>* notes) {
  std::vector<std::string> contacts, quantities;
  const auto add = [](const std::string& item, std::vector<std::string>* list) {
    const auto index = std::ranges::find(*list, item) - list->begin();
    if (index == std::ssize(*list)) list->push_back(item);
    return index;
  };
  std::vector<std::string> problems;
  for (const PublishedRow& row : rows) {
    if (row.table == name) add(row.problem, &problems);
  }
  const auto model_of = [&](const PublishedRow& row) {
    return problems.size() == 1 ? row.contact : row.contact + ", " + row.problem;
  };
  for (const PublishedRow& row : rows) {
    if (row.table != name) continue;
    add(model_of(row), &contacts);
    add(row.quantity, &quantities);
  }
  std::vector<Column> columns = {{"contact"}};
  for (const std::string& quantity : quantities) columns.push_back({HeaderOf(quantity)});
  std::vector<std::vector<Cell>> cells(contacts.size() + 1, std::vector<Cell>(columns.size()));
  for (size_t i = 0; i < contacts.size(); ++i) cells[i][0] = contacts[i];
  cells.back()[0] = "exact dynamics";
  for (const PublishedRow& row : rows) {
    if (row.table != name) continue;
    const auto model = add(model_of(row), &contacts), column = add(row.quantity, &quantities) + 1;
    const bool as_printed = row.IsJudged() && row.Matches() && (row.verdict.empty() || row.verdict == "match");
    std::string text =
        (row.published.empty() ? "–" : row.published) + "\n" + (row.ours ? WithPublishedDecimals(*row.ours, row) : "–");
    std::string note = as_printed ? "" : VerdictInWords(row);
    if (!row.note.empty()) note += (note.empty() ? "" : ": ") + row.note;
    if (!note.empty()) text += " [" + std::to_string(add(note, notes) + 1) + "]";
    const bool missed = row.IsJudged() && !row.Matches();
    cells[model][column] = Cell(text).WithTone(missed           ? Tone::kBad
                                               : as_printed     ? Tone::kPlain
                                               : row.IsJudged() ? Tone::kWarning
                                                                : Tone::kMuted);
    Cell& exact = cells.back()[column];
    if (row.exact && exact.Exact().empty()) exact = WithPublishedDecimals(*row.exact, row);
  }
  Table table(std::move(columns));
  for (std::vector<Cell>& row : cells) table.AddRow(std::move(row));
  return table;
}

}  // namespace saltus
