// Names of parameterised tests.
#pragma once

#include <gtest/gtest.h>

#include <cctype>
#include <string>

namespace saltus {

// Names each test after its parameter, as GoogleTest prints it: letters and digits, the rest as underscores.
struct ParameterName {
  template <typename T>
  std::string operator()(const ::testing::TestParamInfo<T>& test) const {
    std::string name;
    for (const char c : ::testing::PrintToString(test.param)) {
      if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
        name += c;
      } else if (!name.empty() && name.back() != '_') {
        name += '_';
      }
    }
    if (name.ends_with('_')) name.pop_back();
    return name;
  }
};

}  // namespace saltus
