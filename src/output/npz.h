// NumPy archives (.npz): named arrays that numpy.load opens.
//
// An archive is a zip file of stored members <name>.npy in the NPY format, version 1.0 (numpy.lib.format): magic
// string, a header padded so that the data start at a multiple of 64 bytes, then the entries, little-endian, in C
// order.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <variant>
#include <vector>

#include "base/status.h"

namespace saltus {

// An array of any shape; the empty shape is a scalar.
struct NpyArray {
  std::vector<int64_t> shape;
  // Entries in C order (last index fastest), as many as the product of the shape.
  // Text is UTF-8 without zeros (in files UTF-32, as NumPy's str_).
  std::variant<std::vector<double>, std::vector<float>, std::vector<int64_t>, std::vector<std::string>> data;

  bool operator==(const NpyArray&) const = default;
};

// Arrays by key, as in numpy.load(path)[key].
using NpzArrays = std::map<std::string, NpyArray>;

// Returns the bytes of one .npy file. Precondition: data and shape agree, no dimension is negative.
std::string EncodeNpy(const NpyArray& array);

// Reads version 1.0 files of little-endian float64, float32, int64 or str_ in C order; anything else is an error.
StatusOr<NpyArray> DecodeNpy(const std::string& bytes);

// Writes the archive; an existing file at `path` is replaced once the archive is complete. Equal arrays give equal
// bytes (no time stamps). Precondition: at least one array, keys not empty.
Status WriteNpz(const std::string& path, const NpzArrays& arrays);

StatusOr<NpzArrays> ReadNpz(const std::string& path);

}  // namespace saltus
