#include <algorithm>

#include "exact/two_disc_optimum.h"
#include "paper/experiments.h"
#include "programs/scene_drawing.h"
#include "saltus/simulate/registry.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

std::vector<double> Range(size_t count, double step = 1) {
  std::vector<double> values(count);
  for (size_t i = 0; i < count; ++i) values[i] = step * static_cast<double>(i);
  return values;
}

// Returns the experiment in the published precision where it matters, in double otherwise.
const Experiment* Shown(const Experiments& experiments, const std::string& problem, double friction,
                        const std::string& contact) {
  const bool pbd = contact.starts_with("pbd");
  return experiments.Find(problem, friction, contact, pbd ? Precision::kFloat : Precision::kDouble);
}

template <typename Visit>
void ForEachModel(const Experiments& experiments, const std::string& problem, double friction, const Visit& visit) {
  for (const ModelTraits& traits : AllContactModels()) {
    const Experiment* experiment = Shown(experiments, problem, friction, std::string(traits.name));
    const CheckedRun* run = experiment == nullptr ? nullptr : experiment->Find("gd");
    if (run != nullptr && run->report.history.losses.size() > 1) visit(*experiment, run->report);
  }
}

// Adds the paths of the discs of a motion under the experiment's contact model.
void AddPaths(const Experiment& experiment, const MotionInput& input, const std::string& label,
              const std::string& colour, Dash dash, Panel* panel) {
  const Motion motion =
      SimulateMotion(experiment.scene, experiment.contact, input, {.precision = experiment.precision});
  const size_t width = 4 * experiment.scene.bodies.size();
  for (size_t begin = 0; begin < width; begin += 4) {
    Series& path = panel->series.emplace_back(Series{.label = label, .colour = colour, .dash = dash});
    for (size_t i = begin; i < motion.states.size(); i += width) {
      path.x.push_back(motion.states[i]);
      path.y.push_back(motion.states[i + 1]);
    }
  }
}

// Draws the initial trajectory and those after gradient descent under two models, which reach different optima.
Panel TrajectoryPanel(const Experiments& experiments, const std::string& problem, const std::string& title) {
  const Scene& scene = experiments.scene(problem);
  Panel panel = ScenePanel(scene, title);
  for (const Plane& plane : scene.planes) {
    if (plane.normal[1] == 0) panel.x.max = plane.point[0] + 0.15;  // so that a wall to the right is seen
  }
  const Experiment* first = Shown(experiments, problem, 0, "direct_toi");
  if (first == nullptr) return panel;
  const int steps = first->gradient.num_steps;
  const MotionInput initial{InitialState(scene), InitialControl(scene, steps), {}};
  AddPaths(*first, initial, "initial", "#888888", Dash::kDashed, &panel);
  for (const std::string contact : {"direct_toi", "direct"}) {
    const Experiment* experiment = Shown(experiments, problem, 0, contact);
    const CheckedRun* run = experiment == nullptr ? nullptr : experiment->Find("gd");
    if (run == nullptr) continue;
    AddPaths(*experiment,
             {run->report.solution.initial_state, run->report.solution.control, {}},
             "optimised, " + contact,
             ColourOf(contact),
             Dash::kSolid,
             &panel);
  }
  return panel;
}

}  // namespace

Series ForceOf(const SolveReport& report, const Scene& scene, int axis) {
  Series force;
  double end = 0;
  const std::vector<double> lengths = LengthsOf({report.solution.control, report.solution.durations}, scene);
  for (size_t k = 0; k < lengths.size(); ++k) {
    force.x.push_back(end + 0.5 * lengths[k]);
    force.y.push_back(report.solution.control[2 * k + axis]);
    end += lengths[k];
  }
  return force;
}

Series OptimalForce(const Scene& scene) {
  const auto optimum = FindTwoDiscOptimum(scene, TwoDiscSequence::kImpact);
  Series force = Series::ForModel("analytic", {}, {});
  if (optimum) force.x = Range(1001, 1e-3 * scene.duration);
  for (const double time : force.x) force.y.push_back(optimum->Control(time)[0]);
  return force;
}

PaperFigure Trajectories(const Experiments& experiments) {
  Figure figure;
  figure.panels = {TrajectoryPanel(experiments, "bounce_once", "Task 1: one bounce"),
                   TrajectoryPanel(experiments, "ground_wall", "Task 2: ground and wall"),
                   TrajectoryPanel(experiments, "two_balls", "Task 3: two balls")};
  return {
      "The three tasks: initial trajectory, and the trajectory after 1000 updates of gradient descent with and "
      "without the time of impact. Filled dots are targets.",
      figure};
}

PaperFigure GroundWallLearning(const Experiments& experiments, double friction) {
  Panel loss{.title = "Loss", .x = {.label = "gradient-descent iteration"}, .y = {.label = "loss (m²)", .log = true}};
  Panel velocity{.title = "Horizontal velocity", .x = loss.x, .y = {.label = "initial horizontal velocity (m/s)"}};
  ForEachModel(experiments, "ground_wall", friction, [&](const Experiment& experiment, const SolveReport& report) {
    loss.series.push_back(
        Series::ForModel(experiment.contact, Range(report.history.losses.size()), report.history.losses));
    std::vector<double> x;
    for (const std::vector<double>& z : report.history.iterates) x.push_back(z[0]);
    velocity.series.push_back(Series::ForModel(experiment.contact, Range(x.size()), x));
  });
  Figure figure{.panels = {loss, velocity}};
  const std::string with = friction > 0 ? "with friction 0.1" : "without friction";
  return {"Task 2 " + with +
              ": loss and horizontal launch velocity during gradient descent. Models whose gradient has the "
              "wrong sign in x end at another solution, which misses the wall.",
          figure};
}

PaperFigure TwoBallsLearning(const Experiments& experiments) {
  const auto optimum = FindTwoDiscOptimum(experiments.scene("two_balls"), TwoDiscSequence::kImpact);
  Panel loss{
      .title = "Loss", .x = {.label = "gradient-descent iteration"}, .y = {.label = "loss (m², effort included)"}};
  Panel control{
      .title = "Learned force", .x = {.label = "time (s)"}, .y = {.label = "horizontal force on the striker (N)"}};
  ForEachModel(experiments, "two_balls", 0, [&](const Experiment& experiment, const SolveReport& report) {
    loss.series.push_back(
        Series::ForModel(experiment.contact, Range(report.history.losses.size()), report.history.losses));
    const Series force = ForceOf(report, experiment.scene);
    control.series.push_back(Series::ForModel(experiment.contact, force.x, force.y));
  });
  if (optimum) loss.reference_lines.push_back({.value = optimum->loss, .label = "analytic optimum"});
  control.series.push_back(OptimalForce(experiments.scene("two_balls")));
  Figure figure{.panels = {loss, control}};
  return {
      "Task 3: loss during gradient descent, and the force learned after 1000 updates beside the optimal control of "
      "the hybrid minimum principle. A loss below the analytic optimum is an artefact of the time grid.",
      figure};
}

PaperFigure StiffnessLearning(const Experiments& experiments) {
  Panel panel{.x = {.label = "gradient-descent iteration"}, .y = {.label = "loss (m², effort included)"}};
  const std::vector<std::string> stiffnesses = {"1e2", "1e3", "1e4", "1e5"};
  for (size_t i = 0; i < stiffnesses.size(); ++i) {
    const Experiment* experiment =
        experiments.Find("two_balls", 0, "compliant_warp_kn" + stiffnesses[i], Precision::kDouble);
    if (experiment == nullptr) continue;
    const std::vector<double>& losses = experiment->Find("gd")->report.history.losses;
    panel.series.push_back({.label = stiffnesses[i] + " N/m",
                            .x = Range(losses.size()),
                            .y = losses,
                            .colour = RampColour(static_cast<double>(i) / 3)});
  }
  if (const auto optimum = FindTwoDiscOptimum(experiments.scene("two_balls"), TwoDiscSequence::kImpact)) {
    panel.reference_lines.push_back({.value = optimum->loss, .label = "analytic optimum"});
  }
  Figure figure{.panels = {panel}};
  return {"Task 3 with the compliant model at four stiffnesses. The stiffest fails to learn.", figure};
}

PaperFigure SolverLearning(const Experiments& experiments) {
  const auto optimum = FindTwoDiscOptimum(experiments.scene("two_balls"), TwoDiscSequence::kImpact);
  const double best = optimum ? optimum->loss : 0;
  Figure figure;
  for (const std::string solver : {"gd", "ceres_lbfgs", "ceres_lm"}) {
    Panel panel{.title = solver,
                .x = {.label = "iteration", .log = true, .min = 1.0},
                .y = {.label = "loss - optimum (m²)", .log = true, .min = 1e-4}};
    for (const Experiment& experiment : experiments.all()) {
      if (experiment.scene.name != "two_balls" || experiment.precision != Precision::kDouble) continue;
      const CheckedRun* run = experiment.Find(solver);
      if (run == nullptr || run->report.history.losses.size() < 2 || experiment.solvers.size() < 2) continue;
      std::vector<double> gap = run->report.history.losses;
      for (double& loss : gap) loss -= best;
      std::vector<double> iteration = Range(gap.size());
      for (double& k : iteration) k += 1;
      panel.series.push_back(Series::ForModel(experiment.contact, iteration, gap));
    }
    figure.panels.push_back(panel);
  }
  return {
      "Task 3: the loss under each contact model, less the analytic optimum, for three solvers; the initial guess is "
      "iteration 1. Losses below the optimum, which only a wrong model can reach, leave the figure.",
      figure};
}

namespace {

// The models whose motions are shown at first, as they differ most; readers can turn the others on.
constexpr const char* kShown[] = {"event", "direct_toi", "direct"};

}  // namespace

Replay TaskReplay(const Experiments& experiments, const std::string& problem) {
  const Scene& scene = experiments.scene(problem);
  Replay replay{scene};
  const MotionOptions options = ReplayOptions(scene, experiments.all().size());
  const auto add =
      [&](const Motion& motion, const MotionInput& input, const std::string& label, const std::string& style) {
        if (!motion.times.empty()) replay.motions.emplace_back(motion, input, label, style);
      };
  for (const Experiment& experiment : experiments.all()) {
    const Scene& own = experiment.scene;
    if (own.name != problem || own.contact != scene.contact || experiment.precision != Precision::kDouble) continue;
    const CheckedRun* run = experiment.Find("gd");
    MotionInput input{InitialState(own), InitialControl(own, own.steps), {}};
    if (run != nullptr) {
      input = {run->report.solution.initial_state, run->report.solution.control, run->report.solution.durations};
    }
    const std::string& contact = experiment.contact;
    // A motion is added once, as a sweep over stiffnesses may have the scene's too.
    if (std::ranges::any_of(replay.motions, [&](const auto& motion) { return motion.label == contact; })) continue;
    add(SimulateMotion(own, contact, input, options), input, contact, contact);
    const bool shown = std::ranges::find(kShown, contact) != std::end(kShown);
    if (!replay.motions.empty()) replay.motions.back().shown = shown;
    if (contact == "direct" && run != nullptr) {
      add(SimulateExactMotion(own, input, options), input, contact + ", in exact dynamics", "analytic");
    }
  }
  return replay;
}

}  // namespace saltus
