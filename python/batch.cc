// Loss and gradient at many points, on all cores.
#include "saltus/control/batch.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/statistics.h"
#include "convert.h"
#include "motion.h"
#include "programs/json_output.h"
#include "saltus/control/control_rows.h"
#include "scene/units.h"

namespace saltus::python {
namespace {

class PointsOfScene {
 public:
  PointsOfScene(const Scene& scene, const Contact& contact, const std::string& precision, int threads)
      : scene_(scene), near_(NearOrigin(scene)) {
    CheckTakes(contact, near_);
    batch_ = std::make_unique<Batch>(contact, near_, ReadPrecision(precision), ReadThreads(threads));
    batch_->set_stop(user_.stop());
    num_variables_ = batch_->num_variables();
    if (!HasTorques(scene_)) return;
    const int behind = scene_.objective.duration.has_value();
    const int steps = (num_variables_ - behind) / scene_.control_width();
    num_variables_ = steps * scene_.num_controlled() * ControlColumns(scene_) + behind;
  }

  int num_threads() const { return batch_->num_threads(); }
  int num_variables() const { return num_variables_; }

  // Loss() and LossAndGradient() show what is done by `counter` (WorkCount).
  py::tuple LossAndGradient(const py::object& points, const py::object& losses_out, const py::object& gradients_out,
                            const py::object& counter) {
    const Array read = ReadPoints(points);
    const py::ssize_t count = read.shape(0);
    Array losses = WritableArray(losses_out, "losses", {count}, &read);
    Array gradients = WritableArray(gradients_out, "gradients", {count, num_variables()}, &read);
    Evaluate(read, MutableView(losses), MutableView(gradients), counter);
    return py::make_tuple(losses, gradients);
  }

  Array Loss(const py::object& points, const py::object& losses_out, const py::object& counter) {
    const Array read = ReadPoints(points);
    Array losses = WritableArray(losses_out, "losses", {read.shape(0)}, &read);
    Evaluate(read, MutableView(losses), {}, counter);
    return losses;
  }

  // The remarks on the motion of each point, which is simulated again.
  py::list Remarks(const py::object& points) {
    const Array read = ReadPoints(points);
    CheckFinite(read, "points");
    std::vector<saltus::Remarks> found(read.shape(0));
    Computation computation;
    computation.RunOrThrow([&] {
      const OneUser::Use use(&user_, &computation);
      const size_t size = batch_->num_variables();
      const std::span<const double> near = NearVariables(scene_, near_, View(read), &moved_, found.size());
      batch_->ForEach(static_cast<int>(found.size()), [&](SingleShooting* shooting, int i) {
        const std::span<const double> point = near.subspan(i * size, size);
        double loss = 0;
        if (!shooting->Evaluate(point, &loss, nullptr)) return;
        found[i] = RemarksOn(shooting->simulator(), shooting->InitialStateAt(point), shooting->ControlAt(point));
      });
    });
    py::list remarks;
    for (const saltus::Remarks& of_point : found) remarks.append(ToPython(RemarksToJson(of_point)));
    return remarks;
  }

 private:
  // P points, each flat or in the shape of the decision variables.
  Array ReadPoints(const py::object& points) const {
    const py::array any = py::array::ensure(points);
    if (!any || any.ndim() < 2) {
      throw py::value_error("points: expected an array of P points of " + std::to_string(num_variables()) + " numbers");
    }
    const py::ssize_t count = any.shape(0);
    if (any.size() != count * num_variables()) return ReadNumbers(any, "points", {count, num_variables()});
    return ReadNumbers(any.attr("reshape")(count, num_variables()), "points", {count, num_variables()});
  }

  void Evaluate(const Array& points, std::span<double> losses, std::span<double> gradients, const py::object& counter) {
    Computation computation;
    WorkCount count(&computation, counter, std::ssize(losses));
    computation.RunOrThrow([&] {
      const OneUser::Use use(&user_, &computation);
      EvaluateFinite(NearVariables(scene_, near_, View(points), &moved_, losses.size()), losses, gradients, &count);
    });
    const bool all = std::none_of(losses.begin(), losses.end(), [](double loss) { return std::isnan(loss); });
    if (!all) CheckFinite(points, "points");
    for (double& loss : losses) loss = ConvertLoss(loss, near_.units, scene_.units);
  }

  // Evaluates as Batch::Evaluate(), with NaN for points that are not finite. Each point is checked just before its use,
  // as a pass over all points would cost a tenth of the gradients. In lanes their motions are not finite either.
  void EvaluateFinite(std::span<const double> points, std::span<double> losses, std::span<double> gradients,
                      WorkCount* count) {
    const size_t size = batch_->num_variables(), columns = num_variables_;
    const bool torques = HasTorques(scene_);
    if (batch_->num_lanes() > 1 && !torques) {
      constexpr size_t kAtOnce = 4096;  // points, of which lanes are whole
      const size_t at_once = count->shows() ? kAtOnce : losses.size();
      for (size_t first = 0; first < losses.size(); first += at_once) {
        const size_t some = std::min(at_once, losses.size() - first);
        batch_->Evaluate(points.subspan(first * size, some * size),
                         losses.subspan(first, some),
                         gradients.empty() ? gradients : gradients.subspan(first * columns, some * columns));
        count->Add(static_cast<std::int64_t>(some));
      }
      return;
    }
    batch_->ForEach(static_cast<int>(losses.size()), [&](SingleShooting* shooting, int i) {
      if (count->shows()) count->Add(1);
      const std::span<const double> point = points.subspan(i * size, size);
      const std::span<double> gradient = gradients.empty() ? gradients : gradients.subspan(i * columns, columns);
      std::vector<double> own(torques && !gradient.empty() ? size : 0);
      double* const to = gradient.empty() ? nullptr : torques ? own.data() : gradient.data();
      if (AllFinite(point) && shooting->Evaluate(point, &losses[i], to)) {
        if (!own.empty()) PutGradient(scene_, own, gradient);
        return;
      }
      losses[i] = std::numeric_limits<double>::quiet_NaN();
      std::fill(gradient.begin(), gradient.end(), losses[i]);
    });
  }

  Scene scene_, near_;
  std::unique_ptr<Batch> batch_;
  int num_variables_ = 0;  // of a point, as Python has it
  std::vector<double> moved_;
  OneUser user_;
};

}  // namespace

void BindBatch(py::module_* module) {
  py::class_<PointsOfScene>(*module, "Batch")
      .def(py::init([](const Scene& scene, const py::object& contact, const std::string& precision, int threads) {
             return std::make_unique<PointsOfScene>(scene, ReadContact(contact), precision, threads);
           }),
           py::arg("scene"),
           py::arg("contact") = "event",
           py::kw_only(),
           py::arg("precision") = "double",
           py::arg("threads") = 0)
      .def_property_readonly("threads", &PointsOfScene::num_threads)
      .def_property_readonly("num_variables", &PointsOfScene::num_variables)
      .def("remarks", &PointsOfScene::Remarks, py::arg("points"))
      .def("loss",
           &PointsOfScene::Loss,
           py::arg("points"),
           py::arg("losses") = py::none(),
           py::arg("counter") = py::none())
      .def("loss_and_gradient",
           &PointsOfScene::LossAndGradient,
           py::arg("points"),
           py::arg("losses") = py::none(),
           py::arg("gradients") = py::none(),
           py::arg("counter") = py::none());
}

}  // namespace saltus::python
