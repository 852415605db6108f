#include "arrays.h"

#include <cmath>
#include <cstdint>

#include "base/statistics.h"

namespace saltus::python {
namespace {

Shape ShapeOf(const py::array& array) { return {array.shape(), array.shape() + array.ndim()}; }

void CheckShape(const py::array& array, const std::string& name, const Shape& shape) {
  const Shape found = ShapeOf(array);
  if (found == shape || found == Shape{SizeOf(shape)}) return;
  const std::string flat = shape.size() > 1 ? " or " + ShapeToString({SizeOf(shape)}) : "";
  throw py::value_error(name + ": found shape " + ShapeToString(found) + ", expected " + ShapeToString(shape) + flat);
}

std::string TypeName(const py::handle& value) { return py::str(py::type::handle_of(value).attr("__name__")); }

// "[3, 0, 1]", of entry `i` in row-major order.
std::string PlaceOf(py::ssize_t i, const Shape& shape) {
  Shape place(shape.size());
  for (size_t axis = shape.size(); axis-- > 0;) {
    place[axis] = i % shape[axis];
    i /= shape[axis];
  }
  std::string text;
  for (const py::ssize_t index : place) text += (text.empty() ? "" : ", ") + std::to_string(index);
  return "[" + text + "]";
}

bool Overlap(const Array& a, const Array& b) {
  const auto begin = [](const Array& array) { return reinterpret_cast<std::uintptr_t>(array.data()); };
  return begin(a) < begin(b) + b.nbytes() && begin(b) < begin(a) + a.nbytes();
}

}  // namespace

std::string ShapeToString(const Shape& shape) {
  std::string text;
  for (const py::ssize_t length : shape) text += (text.empty() ? "" : ", ") + std::to_string(length);
  return "(" + text + (shape.size() == 1 ? ",)" : ")");
}

py::ssize_t SizeOf(const Shape& shape) {
  py::ssize_t size = 1;
  for (const py::ssize_t length : shape) size *= length;
  return size;
}

void CheckFinite(const Array& array, const std::string& name) {
  const std::span<const double> numbers = View(array);
  if (AllFinite(numbers)) return;
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (std::isfinite(numbers[i])) continue;
    throw py::value_error(name + PlaceOf(static_cast<py::ssize_t>(i), ShapeOf(array)) + ": found " +
                          std::to_string(numbers[i]) + ", expected a finite number");
  }
}

Array ReadArray(const py::handle& value, const std::string& name, const Shape& shape) {
  if (!py::getattr(value, "durations", py::none()).is_none()) {
    throw py::value_error(
        name +
        ": found the control of a run on intervals of different lengths, expected equal ones; where a "
        "plan or durations are taken, pass plan=run or durations=run.durations; for equal intervals pass np.array of "
        "it");
  }
  const Array read = ReadNumbers(value, name, shape);
  CheckFinite(read, name);
  return read;
}

Array ReadNumbers(const py::handle& value, const std::string& name, const Shape& shape) {
  const std::string expected = ", expected real numbers of shape " + ShapeToString(shape);
  const py::array any = py::array::ensure(value);
  if (!any) throw py::type_error(name + ": found " + TypeName(value) + " that is no array" + expected);
  const char kind = any.dtype().kind();
  if (kind != 'f' && kind != 'i' && kind != 'u') {
    throw py::type_error(name + ": found dtype " + std::string(py::str(any.dtype())) + expected);
  }
  CheckShape(any, name, shape);
  const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(any);
  if (!array) throw py::error_already_set();
  return py::reinterpret_borrow<Array>(array);
}

Array WritableArray(const py::object& out, const std::string& name, const Shape& shape, const Array* input) {
  if (out.is_none()) return Array(shape);
  if (!py::isinstance<Array>(out)) {
    const std::string found =
        py::isinstance<py::array>(out) ? "an array of dtype " + std::string(py::str(out.attr("dtype"))) : TypeName(out);
    throw py::type_error(name + ": found " + found + ", expected a C-contiguous array of float64");
  }
  const Array array = py::reinterpret_borrow<Array>(out);
  CheckShape(array, name, shape);
  if (!array.writeable()) throw py::value_error(name + ": found a read-only array, expected one to write to");
  if (input != nullptr && Overlap(array, *input)) {
    throw py::value_error(name + ": found an array that shares memory with the input, expected another one");
  }
  return array;
}

Array ToArray(std::span<const double> values, const Shape& shape) {
  Array array(shape);
  std::copy(values.begin(), values.end(), array.mutable_data());
  return array;
}

}  // namespace saltus::python
