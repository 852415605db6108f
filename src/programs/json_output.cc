#include "programs/json_output.h"

#include <algorithm>
#include <cmath>
#include <iostream>

#include "control/surrogate_names.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"

namespace saltus {

Cell CellOf(const Json& value) {
  if (value.is_boolean()) return value.get<bool>() ? "yes" : "no";
  if (value.is_number_float()) return std::isfinite(value.get<double>()) ? Cell(value.get<double>()) : Cell();
  if (value.is_number()) return value.get<int64_t>();
  if (value.is_string()) return value.get<std::string>();
  return value.is_structured() ? Cell(value.size()) : Cell();
}

namespace {

Json ParametersToJson(const Scene& scene, const ParameterGradient& p) {
  if (p.mass.empty()) return nullptr;
  Json item;
  SALTUS_ADD_MEMBERS(&item, p, restitution, friction, stiffness, damping, gravity, mass, force);
  if (!p.inertia.empty()) item["inertia"] = p.inertia;
  if (!p.drag.empty()) item["drag"] = p.drag;
  if (!p.pairs.empty()) {
    Json& pairs = item["pairs"] = Json::object();
    for (const int pair : PairsInUse(scene)) {
      pairs[NameOfPair(pair, scene)] = {{"restitution", p.pairs[pair].restitution},
                                        {"friction", p.pairs[pair].friction}};
    }
  }
  if (!p.design.empty()) item["design"] = DesignToJson(scene, p.design);
  return item;
}

// Converts rows (control_rows.h), of which a long horizon has millions.
Json RowsToJson(const Scene& scene, const std::vector<double>& rows) {
  const std::vector<int>& turned = scene.control.torque_bodies;
  const size_t columns = ControlColumns(scene), width = columns * scene.num_controlled();
  Json::array_t intervals;
  if (width > 0) intervals.reserve(rows.size() / width);
  for (size_t begin = 0; width > 0 && begin < rows.size(); begin += width) {
    Json::array_t forces;
    forces.reserve(scene.num_controlled());
    for (int c = 0; c < scene.num_controlled(); ++c) {
      const double* row = &rows[begin + c * columns];
      const bool turns = std::ranges::find(turned, scene.control.bodies[c]) != turned.end();
      Json::array_t force(turns ? 3 : 2);
      std::copy_n(row, force.size(), force.begin());
      forces.emplace_back(std::move(force));
    }
    intervals.emplace_back(std::move(forces));
  }
  return intervals;
}

}  // namespace

Json VectorsToJson(const Scene& scene, const std::vector<double>& initial, int offset) {
  Json vectors = Json::array();
  for (size_t i = 0; i < 4 * scene.bodies.size(); i += 4) {
    vectors.push_back({initial[i + offset], initial[i + offset + 1]});
  }
  return vectors;
}

Json RotationsToJson(const Scene& scene, const std::vector<double>& initial, int entry) {
  Json rotations = Json::array();
  for (size_t i = 4 * scene.bodies.size() + entry; i < initial.size(); i += kSpin) {
    rotations.push_back(initial[i]);
  }
  return rotations;
}

Json ControlToJson(const Scene& scene, const std::vector<double>& control) {
  return RowsToJson(scene, RowsOfControl(scene, control));
}

Json ControlGradientToJson(const Scene& scene, const std::vector<double>& gradient) {
  return RowsToJson(scene, RowsOfGradient(scene, gradient));
}

Json EventsToJson(const std::vector<Event>& events) {
  Json list = Json::array();
  for (const Event& event : events) {
    list.push_back({{"time", event.time}, {"a", event.a}, {"b", event.b}, {"mode", ContactModeToString(event.mode)}});
  }
  return list;
}

void Reserve(size_t keys, Json* object) {
  auto& items = object->get_ref<Json::object_t&>();
  items.reserve(items.size() + keys);
}

void AddTies(const std::vector<Tie>& ambiguous, const std::optional<LossSpread>& spread, Json* item) {
  if (ambiguous.empty()) return;
  Json& list = (*item)["ambiguous"] = Json::array();
  for (const Tie& tie : ambiguous) list.push_back({{"time", tie.time}, {"bodies", tie.bodies}});
  if (spread) (*item)["loss_spread"] = {spread->lowest, spread->highest};
}

Json JudgementToJson(const QuantityStudy& study) {
  return {{"verdict", VerdictToString(study.verdict)},
          {"order", study.order},
          {"entries", study.entries},
          {"exact", study.exact},
          {"converges_to", study.finest},
          {"one_sided", study.one_sided},
          {"wrong_signs", study.wrong_signs}};
}

void AddConditioning(const RefinementStudy& study, Json* item) {
  if (!study.conditioning) return;
  SALTUS_ADD_MEMBERS(item, *study.conditioning, condition, rounding);
  (*item)["digits_lost"] = study.conditioning->DigitsLost();
}

Json WidthsToJson(const WidthSweepStudy& study) {
  Json sweeps = Json::array();
  for (const WidthSweep& sweep : study.sweeps) {
    Json& item = sweeps.emplace_back(Json{{"quantity", QuantityToString(sweep.quantity)}});
    SALTUS_ADD_MEMBERS(&item, sweep, entry, gradient, narrow, wide);
    item["exact"] = sweep.exact ? Json(*sweep.exact) : Json();
    item["finding"] = WidthFindingToString(sweep.finding);
    SALTUS_ADD_MEMBERS(&item, sweep, grid_width, widths, slopes);
  }
  return {{"verdict", VerdictToString(study.verdict)}, {"summary", study.Summary()}, {"sweeps", std::move(sweeps)}};
}

void AddCurvature(const Certificate& certificate, Json* item) {
  if (!certificate.curvature) return;
  (*item)["curvature"] = {{"kind", CurvatureToString(certificate.curvature->kind)},
                          {"smallest", certificate.curvature->smallest}};
}

void AddResiduals(const ImpactCertificate& impact, Json* item) {
  SALTUS_ADD_MEMBERS(item, impact, multiplier);
  (*item)["costate_jump"] = impact.jump;
  SALTUS_ADD_MEMBERS(item, impact, hamiltonian, on_node);
}

Json CertificateToJson(const Scene& scene, const Certificate& certificate, const char* of) {
  // Whatever loss a solver has minimized, the conditions are those of the exact one.
  Json item = {
      {"of", of}, {"verdict", VerdictToString(certificate.verdict)}, {"in_words", VerdictInWords(certificate)}};
  if (!certificate.reason.empty()) item["reason"] = certificate.reason;
  AddTies(certificate.ambiguous, std::nullopt, &item);
  using enum Certificate::Verdict;
  if (certificate.verdict == kNotApplicable || certificate.verdict == kAmbiguous) return item;
  item["scope"] = ScopeToString(certificate.scope);
  SALTUS_ADD_MEMBERS(
      &item, certificate, sequences_searched, stationarity, costate_jump, hamiltonian, transversality, gradient);
  AddCurvature(certificate, &item);
  if (certificate.curvature) {
    item["curvature"]["direction"] = ControlToJson(scene, certificate.curvature->direction);
  }
  SALTUS_ADD_MEMBERS(&item, certificate, final_time, initial);
  for (const ParameterCertificate& entry : certificate.parameters) {
    SALTUS_ADD_MEMBERS(&item["parameters"].emplace_back(), entry, name, value, derivative, residual);
  }
  for (const ConstraintCertificate& constraint : certificate.constraints) {
    constexpr const char* kQuantities[] = {"position", "velocity", "angle", "angular_velocity"};
    const Vec2d& nu = constraint.multiplier;
    const bool of_spin = constraint.quantity == TerminalTerm::Quantity::kAngle ||
                         constraint.quantity == TerminalTerm::Quantity::kAngularVelocity;
    const bool is_number = of_spin || constraint.speed_limit;
    const char* quantity = constraint.speed_limit ? "speed" : kQuantities[static_cast<int>(constraint.quantity)];
    Json entry = {
        {"body", constraint.body}, {"quantity", quantity}, {"multiplier", is_number ? Json(nu[0]) : Json(nu)}};
    if (constraint.speed_limit) entry["max"] = *constraint.speed_limit;
    if (constraint.time) entry["time"] = *constraint.time;
    item["constraints"].push_back(std::move(entry));
  }
  Json impacts = Json::array();
  for (const ImpactCertificate& impact : certificate.impacts) {
    Json& entry = impacts.emplace_back();
    SALTUS_ADD_MEMBERS(&entry, impact, time, a, b, speed);
    AddResiduals(impact, &entry);
    SALTUS_ADD_MEMBERS(&entry, impact, theta);
  }
  item["impacts"] = std::move(impacts);
  if (certificate.gradient_combined) {
    SALTUS_ADD_MEMBERS(&item, certificate, gradient_early, gradient_late, gradient_combined);
  }
  return item;
}

Json OptimaToJson(const Scene& scene, const std::vector<LocalOptimum>& optima) {
  Json list = Json::array();
  for (const LocalOptimum& optimum : optima) {
    Json sequence = Json::array();
    for (const Candidate& c : optimum.sequence) {
      const std::string& b = c.plane ? scene.planes[c.b].name : scene.bodies[c.b].name;
      sequence.push_back({{"a", scene.bodies[c.a].name}, {"b", b}});
    }
    list.push_back({{"sequence", std::move(sequence)}, {"loss", optimum.loss}, {"times", optimum.times}});
  }
  return list;
}

Json SearchStatisticsToJson(const SearchStatistics& searched) {
  Json item;
  SALTUS_ADD_MEMBERS(&item, searched, sequences, starts, work, complete, lower_bound);
  if (searched.proof) SALTUS_ADD_MEMBERS(&item, *searched.proof, gap, boxes);
  return item;
}

Json GradientToJson(const Scene& scene, const Sensitivity& gradient) {
  Json item = {{"position", VectorsToJson(scene, gradient.initial, 0)},
               {"velocity", VectorsToJson(scene, gradient.initial, 2)},
               {"control", ControlGradientToJson(scene, gradient.control)},
               {"parameters", ParametersToJson(scene, gradient.parameters)}};
  if (!scene.Spins()) return item;
  item["angle"] = RotationsToJson(scene, gradient.initial, 0);
  item["angular_velocity"] = RotationsToJson(scene, gradient.initial, 1);
  return item;
}

Json DesignToJson(const Scene& scene, const std::vector<double>& values) {
  Json item = Json::object();
  for (size_t i = 0; i < values.size(); ++i) {
    item[NameOf(scene.design[i].parameter, scene)] = values[i];
  }
  return item;
}

Json OneSidedToJson(const Scene& scene, const std::vector<OneSided>& entries) {
  Json list = Json::array();
  for (const OneSided& entry : entries) {
    list.push_back({{"body", scene.bodies[entry.body].name},
                    {"quantity", QuantityToString(entry.quantity)},
                    {"component", entry.component == 0 ? "x" : "y"},
                    {"side", SideToString(entry.side)}});
  }
  return list;
}

std::vector<double> NumbersIn(const Json& json) {
  std::vector<double> numbers;
  if (json.is_number()) return {json.get<double>()};
  for (const Json& item : json) {
    const std::vector<double> more = NumbersIn(item);
    numbers.insert(numbers.end(), more.begin(), more.end());
  }
  return numbers;
}

Table TableOf(const Json& parents, const std::string& list, const std::string& columns, size_t keys, size_t most_rows) {
  std::vector<Column> heads = ColumnsOf(columns);
  std::vector<std::string> paths;
  std::vector<bool> of_parent, of_each;
  for (Column& head : heads) {
    const size_t equals = head.header.find('=');
    std::string path = head.header.substr(equals == std::string::npos ? 0 : equals + 1);
    head.header.resize(std::min(equals, head.header.size()));
    std::ranges::replace(path, ' ', '_');
    of_parent.push_back(path.starts_with('^'));
    of_each.push_back(path.ends_with("[]"));
    if (of_parent.back()) path.erase(0, 1);
    if (of_each.back()) path.resize(path.size() - 2);
    paths.push_back("/" + path);
  }
  const auto at = [](const Json& item, const std::string& path) -> const Json& {
    static const Json& nothing = *new Json;
    const Json::json_pointer pointer(path);
    return item.contains(pointer) ? item[pointer] : nothing;
  };
  Table table(std::move(heads), keys);
  const auto add = [&](const Json& item, const Json& parent) {
    size_t rows = 1;
    for (size_t j = 0; j < paths.size(); ++j) {
      if (of_each[j]) rows = at(item, paths[j]).size();
    }
    for (size_t i = 0; i < rows && table.rows().size() < most_rows; ++i) {
      std::vector<Cell> row;
      for (size_t j = 0; j < paths.size(); ++j) {
        const Json& found = at(of_parent[j] ? parent : item, paths[j]);
        const bool counts = paths[j] == "/#";
        row.push_back(counts ? Cell(table.rows().size() + 1) : CellOf(of_each[j] ? found[i] : found));
      }
      table.AddRow(std::move(row));
    }
  };
  for (const Json& parent : parents) {
    const Json& items = list.empty() ? parent : at(parent, list);
    if (items.is_object()) add(items, parent);
    if (!items.is_array()) continue;
    for (const Json& item : items) add(item, parent);
  }
  return table;
}

Json RemarksToJson(const Remarks& remarks) {
  Json list = Json::array();
  for (const Remark& remark : remarks) list.push_back({{"kind", remark.kind}, {"text", remark.text}});
  return list;
}

std::string JsonText(const Json& document) {
  return document.dump(1, ' ', /*ensure_ascii=*/false, Json::error_handler_t::replace) + "\n";
}

void PrintJson(const Json& document) { std::cout << JsonText(document) << std::flush; }

std::string FileSuffix(const std::optional<Surrogate>& surrogate) {
  return surrogate ? "_" + std::string(SurrogateToString(surrogate->kind)) + "_biased" : "";
}

void AddSurrogate(const std::optional<Surrogate>& surrogate, Json* item) {
  if (!surrogate) return;
  (*item)["surrogate"] = SurrogateToString(surrogate->kind);
  (*item)["biased"] = true;
  if (!surrogate->smooths()) return;
  SALTUS_ADD_MEMBERS(&(*item)["smoothing"], *surrogate, sigma, samples, seed, segments);
}

void AddBias(const std::string& contact, const std::optional<Surrogate>& surrogate, Json* item) {
  AddSurrogate(surrogate, item);
  if (IsBiased(contact)) (*item)["biased"] = true;
}

}  // namespace saltus
