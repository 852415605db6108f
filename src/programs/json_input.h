// JSON and NPZ files that users hand to the programs.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "output/npz.h"
#include "programs/json_output.h"

namespace saltus {

// The document in `text`. What is none is an InputError that begins with `where` and names the line and column, and
// `expected`, such as "a JSON object".
Json ParseJson(const std::string& text, const std::string& where, const std::string& expected);

// The base of readers of such files; their errors name the place in the file.
class InputReader {
 public:
  // Errors begin with `where`.
  explicit InputReader(std::string where) : where_(std::move(where)) {}

  const std::string& where() const { return where_; }

  // Throws InputError: the value under `key` is not the expected one.
  [[noreturn]] void Fail(const std::string& key, const std::string& expected) const;

  // The numbers of an array, which fails if it has text.
  std::vector<double> Numbers(const NpyArray& array, const std::string& key) const;

 private:
  std::string where_;
};

}  // namespace saltus
