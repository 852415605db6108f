#include "convert.h"

#include <algorithm>
#include <cmath>
#include <thread>

#include "saltus/control/control_rows.h"
#include "saltus/simulate/events.h"

namespace saltus::python {

py::object ToPython(const Json& value) {
  if (value.is_object()) {
    py::dict dict;
    for (const auto& [key, child] : value.items()) dict[py::str(key)] = ToPython(child);
    return dict;
  }
  if (value.is_array()) {
    py::list list(value.size());
    for (size_t i = 0; i < value.size(); ++i) list[i] = ToPython(value[i]);
    return list;
  }
  if (value.is_string()) return py::str(value.get_ref<const std::string&>());
  if (value.is_boolean()) return py::bool_(value.get<bool>());
  if (value.is_number_unsigned()) return py::int_(value.get<std::uint64_t>());
  if (value.is_number_integer()) return py::int_(value.get<std::int64_t>());
  if (value.is_number_float() && std::isfinite(value.get<double>())) return py::float_(value.get<double>());
  return py::none();
}

Precision ReadPrecision(const std::string& name) {
  if (name == "double") return Precision::kDouble;
  if (name == "float") return Precision::kFloat;
  throw py::value_error("precision: found '" + name + "', expected 'double' or 'float'");
}

void Raise(const SceneFileError& error) {
  const py::object type = py::module_::import("saltus._scene").attr("SceneError");
  const py::object raised = type(error.file, error.line, error.key, error.message);
  PyErr_SetObject(type.ptr(), raised.ptr());
  throw py::error_already_set();
}

void CheckRows(const Scene& scene, const std::string& name, std::span<const double> rows) {
  if (const std::string why = ValidateControlRows(scene, rows); !why.empty()) throw py::value_error(name + ": " + why);
}

void CheckTakes(const Contact& contact, const Scene& scene) {
  const std::string reason_not_applicable = ReasonNotApplicable(contact, scene);
  if (!reason_not_applicable.empty()) throw py::value_error("contact " + contact.name() + ": " + reason_not_applicable);
}

void WarnOfRemark(const std::string& remark) {
  if (!remark.empty() && PyErr_WarnEx(PyExc_RuntimeWarning, remark.c_str(), 1) < 0) throw py::error_already_set();
}

void WarnOfUnresolved(int unresolved_steps, int num_steps) {
  if (unresolved_steps == 0) return;
  WarnOfRemark("the motion is right to first order in the step only: " +
               DescribeUnresolved(unresolved_steps, num_steps) + "; use more steps");
}

Contact ReadContact(const py::handle& contact) {
  if (py::isinstance<Contact>(contact)) return contact.cast<Contact>();
  if (!py::isinstance<py::str>(contact)) {
    throw py::type_error("contact: found " + std::string(py::str(py::type::handle_of(contact).attr("__name__"))) +
                         ", expected the name of a contact model");
  }
  const Contact read(contact.cast<std::string>());
  const std::string wrong = Validate(read);
  if (!wrong.empty()) throw py::value_error("contact: " + wrong);
  return read;
}

std::optional<Surrogate> ReadSurrogate(const py::object& surrogate) {
  if (surrogate.is_none()) return std::nullopt;
  const py::dict given =
      py::isinstance<py::str>(surrogate) ? py::dict(py::arg("kind") = surrogate) : py::dict(surrogate);
  Surrogate read;
  std::string names;
  bool found = false;
  for (const auto& [key_handle, value] : given) {
    const std::string key = py::str(key_handle);
    if (key == "kind") {
      for (const SurrogateEntry& entry : AllSurrogates()) {
        names += (names.empty() ? "" : ", ") + std::string(entry.name);
        if (value.cast<std::string>() != entry.name) continue;
        read.kind = entry.kind;
        found = true;
      }
    } else if (key == "sigma") {
      read.sigma = value.cast<double>();
    } else if (key == "samples") {
      read.samples = value.cast<int>();
    } else if (key == "seed") {
      read.seed = value.cast<std::uint64_t>();
    } else if (key == "segments") {
      read.segments = value.cast<int>();
    } else {
      throw py::value_error("surrogate: found key '" + key + "', expected kind, sigma, samples, seed, segments");
    }
  }
  if (!found) throw py::value_error("surrogate: expected a kind of " + names);
  const std::string wrong = Validate(read);
  if (!wrong.empty()) throw py::value_error("surrogate: " + wrong);
  return read;
}

int ReadThreads(int threads) {
  constexpr int kMost = 4096;
  if (threads < 0 || threads > kMost) {
    throw py::value_error("threads: found " + std::to_string(threads) + ", expected a number in 0.." +
                          std::to_string(kMost));
  }
  return threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

}  // namespace saltus::python
