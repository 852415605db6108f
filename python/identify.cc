// Parameters of scenes from recordings of their motion, as the program saltus_identify reports them.
#include "saltus/identify/identify.h"

#include <pybind11/stl.h>

#include <cmath>

#include "arrays.h"
#include "computation.h"
#include "convert.h"
#include "programs/identification.h"

namespace saltus::python {
namespace {

// Names or indices of bodies as text or whole numbers, all else as doubles.
NpyArray ReadColumn(const std::string& key, const py::handle& value, const std::string& name) {
  const bool bodies = key == "body";
  const std::string expected = bodies ? "names or indices of bodies" : "real numbers";
  py::array any = py::array::ensure(value);
  if (!any) throw py::type_error(name + ": found no array, expected " + expected);
  if (bodies && any.dtype().kind() == 'O') any = any.attr("astype")("str");  // a column of pandas
  NpyArray column;
  column.shape.assign(any.shape(), any.shape() + any.ndim());
  const char kind = any.dtype().kind();
  if (bodies && kind == 'U') {
    column.data = any.attr("ravel")().attr("tolist")().cast<std::vector<std::string>>();
  } else if (bodies && (kind == 'i' || kind == 'u')) {
    column.data = any.attr("ravel")().attr("tolist")().cast<std::vector<std::int64_t>>();
  } else if (!bodies && (kind == 'f' || kind == 'i' || kind == 'u')) {
    column.data = ToVector(ReadNumbers(any, name, {any.shape(), any.shape() + any.ndim()}));
  } else {
    throw py::type_error(name + ": found dtype " + std::string(py::str(any.dtype())) + ", expected " + expected);
  }
  return column;
}

// The path of a file, or a dict of arrays.
Recording ReadRecording(const py::handle& given, const std::string& name, const Scene& scene) {
  std::variant<Recording, RecordingError> read;
  if (py::isinstance<py::str>(given)) {
    read = LoadAnyRecording(given.cast<std::string>(), scene);
  } else {
    NpzArrays columns;
    for (const auto& [key_handle, value] : given.cast<py::dict>()) {
      const std::string key = py::str(key_handle);
      columns[key] = ReadColumn(key, value, name + "['" + key + "']");
    }
    read = RecordingFromArrays(columns, name, scene);
  }
  if (const auto* error = std::get_if<RecordingError>(&read)) throw py::value_error(error->ToString());
  return std::get<Recording>(std::move(read));
}

struct FitKeywords {
  std::string law, events, loss;
  double loss_scale, segment, seconds;
  bool known_start;
  int starts, threads;
};

IdentifyOptions ReadFitOptions(const Scene& scene, const FitKeywords& keywords) {
  IdentifyOptions options;
  const std::optional<RobustLoss> loss = ParseRobustLoss(keywords.loss);
  if (!loss) throw py::value_error("loss: found '" + keywords.loss + "', expected none, huber or cauchy");
  if (!(keywords.loss_scale > 0) || !std::isfinite(keywords.loss_scale)) {
    throw py::value_error("loss_scale: expected a finite number > 0");
  }
  if (!(keywords.segment >= 0)) throw py::value_error("segment: expected a time of at least 0 s");
  if (keywords.starts < 1) throw py::value_error("starts: expected a number of at least 1");
  if (!keywords.law.empty()) {
    auto law = ParseLaw(keywords.law, scene);
    if (const auto* wrong = std::get_if<std::string>(&law)) {
      throw py::value_error("law: found '" + keywords.law + "', " + *wrong);
    }
    options.law = std::get<ImpactLaw>(std::move(law));
  }
  if (!keywords.events.empty()) {
    auto events = ParseEvents(keywords.events, scene);
    if (const auto* wrong = std::get_if<std::string>(&events)) {
      throw py::value_error("events: found '" + keywords.events + "', " + *wrong);
    }
    options.events = std::get<EventFunctions>(std::move(events));
  }
  options.loss = *loss;
  options.loss_scale = keywords.loss_scale;
  options.segment = keywords.segment;
  options.initial_states = !keywords.known_start;
  options.starts = keywords.starts;
  options.threads = ReadThreads(keywords.threads);
  return options;
}

// A fit, the function that writes its page to a folder, and what has stopped it: an exception or None.
py::tuple IdentifyScene(const Scene& scene, const py::list& recordings, const std::string& unknown,
                        const py::object& contact_name, const py::object& status, const FitKeywords& keywords) {
  const Contact contact = ReadContact(contact_name);
  IdentifyOptions options = ReadFitOptions(scene, keywords);
  const bool learns = options.law || options.events;
  auto unknowns = learns && unknown.empty() ? std::vector<Unknown>() : ParseUnknowns(unknown, scene);
  if (const auto* wrong = std::get_if<std::string>(&unknowns)) throw py::value_error("unknown: " + *wrong);
  Identified identified{.recordings = {}, .contacts = {contact.name()}, .reports = {}};
  for (size_t i = 0; i < recordings.size(); ++i) {
    const std::string name = "recordings[" + std::to_string(i) + "]";
    identified.recordings.push_back(ReadRecording(recordings[i], name, scene));
  }
  Computation computation(keywords.seconds);
  options.stop = computation.stop();
  if (!status.is_none()) {
    options.status = [&](const std::string& text) { computation.WithPython([&] { status(text); }); };
  }
  computation.Run([&] {
    identified.reports.push_back(
        Identify(contact, scene, identified.recordings, std::get<std::vector<Unknown>>(unknowns), options));
  });
  IdentifyReport& report = identified.reports[0];
  if (report.verdict == FitVerdict::kNotApplicable) throw py::value_error(contact.name() + ": " + report.reason);
  if (report.verdict == FitVerdict::kInterrupted && report.reason.empty()) report.reason = computation.WhyTimedOut();
  const Json document = IdentifiedToJson(scene, identified);
  const py::object result = ToPython(document["fits"][0]);
  const py::cpp_function page([scene, identified = std::move(identified), document](const std::string& folder) {
    Request request;
    request.scene = scene;
    request.output_dir = folder;
    Computation().RunOrThrow([&] { WriteIdentifyReport(request, identified, document); });
  });
  return py::make_tuple(result, page, computation.StoppedBy());
}

}  // namespace

void BindIdentify(py::module_* module) {
  module->def(
      "identify",
      [](const Scene& scene,
         const py::list& recordings,
         const std::string& unknown,
         const py::object& contact,
         const std::string& law,
         const std::string& events,
         const std::string& loss,
         double loss_scale,
         double segment,
         double seconds,
         bool known_start,
         int starts,
         int threads,
         const py::object& status) {
        return IdentifyScene(scene,
                             recordings,
                             unknown,
                             contact,
                             status,
                             {law, events, loss, loss_scale, segment, seconds, known_start, starts, threads});
      },
      py::arg("scene"),
      py::arg("recordings"),
      py::arg("unknown"),
      py::arg("contact"),
      py::kw_only(),
      py::arg("law"),
      py::arg("events"),
      py::arg("loss"),
      py::arg("loss_scale"),
      py::arg("segment"),
      py::arg("seconds"),
      py::arg("known_start"),
      py::arg("starts"),
      py::arg("threads"),
      py::arg("status"));
}

}  // namespace saltus::python
