#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "output/page.h"

namespace saltus {
namespace {

using nlohmann::ordered_json;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// One number, without the end of its line.
std::string Dumped(double value, int significant_digits = kDoubleDigits) {
  std::string text = DumpJson(ordered_json(value), significant_digits);
  text.pop_back();
  return text;
}

TEST(DumpJsonTest, NumbersHaveTheDigitsAskedFor) {
  EXPECT_EQ(Dumped(0.1), "0.10000000000000001");
  EXPECT_EQ(Dumped(1.0 / 3.0, kFloatDigits), "0.333333333");
  EXPECT_EQ(Dumped(0.1f, kFloatDigits), "0.100000001");
  EXPECT_EQ(Dumped(1e300), "1.0000000000000001e+300");
  EXPECT_EQ(Dumped(1e20), "1e+20");
  EXPECT_EQ(Dumped(-2.5), "-2.5");
}

TEST(DumpJsonTest, WholeNumbersStayFloatingPoint) {
  EXPECT_EQ(Dumped(2.0), "2.0");
  EXPECT_EQ(Dumped(-0.0), "-0.0");
  EXPECT_TRUE(std::signbit(ordered_json::parse(Dumped(-0.0)).get<double>()));
}

TEST(DumpJsonTest, NumbersReadBackAsTheSameBits) {
  for (int exponent = -300; exponent <= 300; ++exponent) {
    const double value = std::sin(exponent + 0.5) * std::pow(10.0, exponent);
    EXPECT_EQ(std::strtod(Dumped(value).c_str(), nullptr), value);
  }
  const float smallest = std::numeric_limits<float>::denorm_min();
  EXPECT_EQ(std::strtof(Dumped(smallest, kFloatDigits).c_str(), nullptr), smallest);
}

TEST(DumpJsonTest, HasNoWordForNanAndInfinity) {
  for (const double value : {kNan, kInfinity, -kInfinity}) EXPECT_EQ(Dumped(value), "null");
  const ordered_json document = {{"runs", {{{"final_loss", 1.0}}, {{"losses", {1.0, kNan}}}}}};
  EXPECT_EQ(DumpJson(document), "{\n  \"runs\": [{\"final_loss\": 1.0}, {\"losses\": [1.0, null]}]\n}\n");
}

TEST(DumpJsonTest, IsReadable) {
  const ordered_json document = {
      {"scene", "two \"balls\""},
      {"steps", 480},
      {"gradient", {{"position", {{1.0, 0.5}, {0.0, 0.0}}}, {"control", ordered_json::array()}}},
      {"note", nullptr},
      {"ok", true}};
  EXPECT_EQ(DumpJson(document), R"({
  "scene": "two \"balls\"",
  "steps": 480,
  "gradient": {"position": [[1.0, 0.5], [0.0, 0.0]], "control": []},
  "note": null,
  "ok": true
}
)");
}

TEST(DumpJsonTest, LongDocumentsAreBrokenBefore120ColumnsAndReadBackEqual) {
  ordered_json document;
  for (int i = 0; i < 100; ++i) {
    const double x = std::sin(i) * std::pow(10.0, i % 7 - 3);
    document["losses"].push_back(x);
    document["velocity"].push_back({x, -x / 3});
    document["events"].push_back({{"time", x}, {"a", "striker"}, {"b", "target"}, {"mode", "slip"}});
    document["control"].push_back({{x, 1.0}, {x / 7, 2.0}, {3.0, 4.0}, {x, x}});
  }
  const std::string text = DumpJson(document);
  EXPECT_EQ(ordered_json::parse(text), document);
  std::istringstream lines(text);
  int count = 0;
  for (std::string line; std::getline(lines, line); ++count) EXPECT_LE(line.size(), 120u) << line;
  EXPECT_LT(count, 500);  // one number a line would be more than 1500
}

TEST(DumpJsonTest, EntryThatIsTooLongForALineIsOpenedUp) {
  const std::string word(70, 'x');
  const ordered_json document = {{"runs", {{{"a", word}, {"b", word}}}}};
  EXPECT_EQ(DumpJson(document),
            "{\n  \"runs\": [\n    {\n      \"a\": \"" + word + "\",\n      \"b\": \"" + word + "\"\n    }\n  ]\n}\n");
}

TEST(DumpJsonTest, TakesAnyBytesAndScalarDocuments) {
  EXPECT_EQ(DumpJson(ordered_json("bad \xff byte")), "\"bad \xEF\xBF\xBD byte\"\n");
  EXPECT_EQ(DumpJson(ordered_json(0.5)), "0.5\n");
  EXPECT_EQ(DumpJson(ordered_json::object()), "{}\n");
  EXPECT_EQ(DumpJson(ordered_json({1.0, 2.0})), "[1.0, 2.0]\n");
}

}  // namespace
}  // namespace saltus
