#include "programs/audit_report.h"

#include <algorithm>

#include "base/interrupt.h"
#include "output/html_report.h"
#include "programs/audit_files.h"
#include "programs/audit_tables.h"
#include "programs/perturbed_flow.h"
#include "programs/replay_scene.h"
#include "programs/report_parts.h"
#include "programs/scene_panel.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr size_t kMostMotions = 24;    // in a replay
constexpr size_t kShownMotions = 4;    // of these, at first
constexpr size_t kMostWrongSteps = 6;  // drawn
constexpr size_t kModelsAbreast = 8;   // columns of gradients
constexpr size_t kManyNumbers = 1000;  // of a table that opens when asked

MotionInput StartOf(const Scene& scene) { return {InitialState(scene), InitialControl(scene, scene.steps), {}}; }

std::vector<Tile> TilesOf(const AuditReport& audit) {
  int right = 0, wrong = 0, judged = 0;
  for (const ModelAudit& model : audit.models) {
    const Tone tone = ToneOf(model.verdict);
    right += tone == Tone::kGood;
    wrong += tone == Tone::kBad;
    judged += model.gradient.ok();
  }
  return {{std::to_string(right), "gradients that are right", right > 0 ? Tone::kGood : Tone::kPlain},
          {std::to_string(wrong), "gradients that are wrong", wrong > 0 ? Tone::kBad : Tone::kPlain},
          {std::to_string(judged), "contact models that take the scene"}};
}

void AddMotions(const Request& request, const AuditReport& audit, HtmlReport* report) {
  const Scene& scene = request.scene;
  const MotionInput start = StartOf(scene);
  Replay replay = ReplayOf(scene);
  const MotionOptions options = ReplayOptions(scene, std::min(audit.models.size() + 1, kMostMotions));
  const auto add = [&](const Motion& motion, const std::string& label, const std::string& style) {
    if (motion.times.empty() || replay.motions.size() == kMostMotions) return;
    replay.motions.push_back(ToReplayMotion(scene, motion, start, label, style));
    replay.motions.back().shown = replay.motions.size() <= kShownMotions;
  };
  add(SimulateExactMotion(scene, start, options), "exact dynamics", "analytic");
  for (const ModelAudit& model : audit.models) {
    const std::string& contact = model.gradient.contact;
    // Whatever a simulator of somebody else is called, its motion is not that of a contact model.
    if (!model.gradient.ok() || model.black_box || FindContactModel(contact)->event_driven) continue;
    MotionOptions own = options;
    own.precision = request.precision;
    add(SimulateMotion(scene, contact, start, own), contact, contact);
  }
  if (replay.motions.empty()) return;
  report->AddHeading(1, "Motions");
  report->AddReplay(
      replay, "The scene from its start under each contact model. A right motion does not make a right gradient.");
}

// The discs at the step from which on a gradient is wrong, and the normal of the contact. Precondition: the motion has
// a state.
Panel WrongStepPanel(const Scene& scene, const ModelAudit& model, const ContactError& contact, const Motion& motion) {
  Panel panel = ScenePanel(scene, model.gradient.contact + ", step " + std::to_string(contact.first_step));
  panel.circles.clear();
  const size_t width = 4 * scene.bodies.size();
  const size_t row = std::min<size_t>(contact.first_step, motion.times.size() - 1);
  const auto find = [](const auto& list, const std::string& name) {
    return std::find_if(list.begin(), list.end(), [&](const auto& item) { return item.name == name; }) - list.begin();
  };
  const auto position = [&](size_t i) {
    return Vec2d(motion.states[row * width + 4 * i], motion.states[row * width + 4 * i + 1]);
  };
  for (size_t i = 0; i < scene.bodies.size(); ++i) {
    const Body& body = scene.bodies[i];
    const bool meets = body.name == contact.a || body.name == contact.b;
    panel.circles.push_back(
        {{position(i)[0], position(i)[1]}, body.radius, meets ? ColourOf(model.gradient.contact) : "#555555", 0.25});
  }
  const std::vector<WallPart> walls = WallPartsOf(scene);
  const size_t a = find(scene.bodies, contact.a), b = find(scene.bodies, contact.b), wall = find(walls, contact.b);
  if (a == scene.bodies.size()) return panel;
  Vec2d normal = Vec2d::Zero();
  if (b < scene.bodies.size()) {
    normal = (position(a) - position(b)).normalized();
  } else if (wall < walls.size()) {
    normal = Separate(position(a), walls[wall].wall).normal;
    // A wall with two sides is met from where the disc is.
    const bool behind = !walls[wall].extent.endless && Separate(position(a), walls[wall].wall).distance < 0;
    if (behind) normal = -normal;
  }
  const Vec2d from = position(a) - scene.bodies[a].radius * normal, to = from + 2 * scene.bodies[a].radius * normal;
  panel.segments.push_back({{from[0], from[1]}, {to[0], to[1]}, "#b3261e", 2, true});
  AddPaths(scene, motion, "", ColourOf(model.gradient.contact), Dash::kDotted, &panel);
  return panel;
}

// In rows of at most three.
void AddPanels(std::vector<Panel> panels, const std::string& caption, HtmlReport* report) {
  Figure figure;
  figure.columns = std::min<int>(3, static_cast<int>(panels.size()));
  figure.width = 400 * figure.columns;
  figure.legend = Legend::kNone;
  figure.panels = std::move(panels);
  AddFigureOrReason(figure, caption, report);
}

void AddWrongSteps(const Request& request, const AuditReport& audit, HtmlReport* report) {
  std::vector<Panel> steps, flows;
  std::vector<std::string> reasons;
  for (const ModelAudit& model : audit.models) {
    const ContactError* contact = model.FirstWrong();
    if (contact == nullptr) continue;
    reasons.push_back("`" + model.gradient.contact + "`: " + model.Why());
    if (steps.size() == kMostWrongSteps || model.black_box || InterruptGuard::GraceIsOver()) continue;
    MotionOptions options;
    options.stop = InterruptGuard::GraceIsOver;
    const Motion motion = SimulateMotion(request.scene, model.gradient.contact, StartOf(request.scene), options);
    if (motion.times.empty()) continue;  // interrupted
    steps.push_back(WrongStepPanel(request.scene, model, *contact, motion));
    Panel flow = PerturbedFlowPanel(request.scene, model.gradient.contact, *contact);
    if (!flow.series.front().x.empty()) flows.push_back(std::move(flow));
  }
  if (reasons.empty()) return;
  report->AddHeading(1, "Where gradients go wrong");
  report->AddList(reasons);
  if (steps.empty()) return;
  AddPanels(std::move(steps),
            "The first step that is wrong, of the first models that have one: discs there, their paths, and the "
            "contact's normal.",
            report);
  if (flows.empty()) return;
  AddPanels(std::move(flows),
            "What that contact makes of a displacement: the first disc is moved by 1 along the normal, before. Solid: "
            "under the model; dashed: under exact dynamics; thin: what it does to the second disc.",
            report);
}

}  // namespace

void AddAuditSections(const Request& request, const AuditReport& audit, HtmlReport* report) {
  report->AddHeading(1, "Which gradients are right");
  report->AddTiles(TilesOf(audit));
  report->AddTable(VerdictTable(audit), "Verdicts on the gradients of the loss at the start.");
  Table gradients = GradientTable(request, audit);
  const size_t entries = gradients.columns().size(), models = gradients.rows().size();
  if (entries > 12 && models <= kModelsAbreast) gradients = gradients.Transposed("entry", audit.reference ? 2 : 1);
  report->AddTable(gradients, "Gradients.", /*folded=*/entries * models > kManyNumbers);
  const Table plateaus = PlateauTable(audit);
  if (!plateaus.rows().empty()) report->AddTable(plateaus, "Differences of the loss of every width.");
  AddMotions(request, audit, report);
  if (request.options.surrogate) return;
  AddWrongSteps(request, audit, report);
  const Figure refinement = RefinementFigure(request.scene, audit);
  const bool swept = std::any_of(
      audit.models.begin(), audit.models.end(), [](const ModelAudit& model) { return model.widths.has_value(); });
  if (refinement.panels.empty() && !swept) return;
  report->AddHeading(1, "Errors by step and width");
  if (!refinement.panels.empty()) {
    AddFigureOrReason(refinement, "The error of the gradient as steps shrink.", report);
  }
  if (!swept) return;
  const Figure widths = WidthFigure(request.scene, audit);
  if (!widths.panels.empty()) {
    AddFigureOrReason(widths, "Differences of the loss, from narrower to wider than a step.", report);
  }
}

void WriteAuditReport(const Request& request, const AuditReport& audit) {
  if (request.output_dir.empty()) return;
  HtmlReport report = StartReport(request.scene);
  AddAuditSections(request, audit, &report);
  FinishReport(request, &report);
}

}  // namespace saltus
