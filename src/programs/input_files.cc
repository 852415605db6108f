#include "programs/input_files.h"

#include <algorithm>

#include "programs/program.h"

namespace saltus {

Json ParseJson(const std::string& text, const std::string& where, const std::string& expected) {
  if (text.find_first_not_of(" \t\r\n") == std::string::npos) {
    throw InputError(where + ": the file is empty, expected " + expected);
  }
  try {
    return Json::parse(text);
  } catch (const Json::parse_error& error) {
    // `byte` counts from 1, and is one behind the text where that ends too early.
    const size_t at = std::min(error.byte > 0 ? error.byte - 1 : 0, text.size());
    const auto end = text.begin() + static_cast<std::ptrdiff_t>(at);
    const size_t before = text.find_last_of('\n', at == 0 ? 0 : at - 1);
    const size_t start = at == 0 || before == std::string::npos ? 0 : before + 1;
    throw InputError(where + ": line " + std::to_string(1 + std::count(text.begin(), end, '\n')) + ", column " +
                     std::to_string(at - start + 1) + ": found " +
                     (at == text.size() ? "the end of the file" : "text that is not JSON") + ", expected " + expected);
  } catch (const Json::exception&) {
    throw InputError(where + ": found a number that is too large, expected " + expected);
  }
}

void InputReader::Fail(const std::string& key, const std::string& expected) const {
  throw InputError(where_ + ": " + key + ": expected " + expected);
}

std::vector<double> InputReader::Numbers(const NpyArray& array, const std::string& key) const {
  if (std::optional<std::vector<double>> numbers = NumbersOf(array)) return *std::move(numbers);
  Fail(key, "numbers");
}

}  // namespace saltus
