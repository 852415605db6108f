// numpy arrays as arguments: numbers in, and places to write to, with errors that name the argument and what is
// expected.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <span>
#include <string>
#include <vector>

namespace saltus::python {

namespace py = pybind11;

using Array = py::array_t<double, py::array::c_style>;
using Shape = std::vector<py::ssize_t>;

// Returns a shape as numpy writes it: "(480, 1, 2)".
std::string ShapeToString(const Shape& shape);
py::ssize_t SizeOf(const Shape& shape);

// `value` as doubles in row-major order, without a copy if it is that already. It has the given shape, or is flat with
// as many numbers. TypeError if it is no array of real numbers; ValueError for another shape and for what is not
// finite.
Array ReadArray(const py::handle& value, const std::string& name, const Shape& shape);
// Reads numbers, finite or not, for callers that check by themselves.
Array ReadNumbers(const py::handle& value, const std::string& name, const Shape& shape);
// ValueError that names the first number that is not finite.
void CheckFinite(const Array& array, const std::string& name);

// `out`, to be written to, or a new array if it is None. TypeError unless it is an array of doubles in row-major order;
// ValueError for another shape than those of ReadArray, one that may not be written to, or one that overlaps `input`.
Array WritableArray(const py::object& out, const std::string& name, const Shape& shape, const Array* input = nullptr);

inline std::span<const double> View(const Array& array) { return {array.data(), static_cast<size_t>(array.size())}; }
inline std::span<double> MutableView(Array& array) { return {array.mutable_data(), static_cast<size_t>(array.size())}; }
inline std::vector<double> ToVector(const Array& array) { return {array.data(), array.data() + array.size()}; }

// A new array with a copy of `values`.
Array ToArray(std::span<const double> values, const Shape& shape);

}  // namespace saltus::python
