#include "programs/json_output.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace saltus {
namespace {

const Json kAudits = Json::parse(R"([
  {"contact": "lcp", "found": {"step": 3, "exact": true, "at": [0.25, null]}, "contacts": [
    {"first_step": 7, "error": 0.123456789, "why": "a, b", "widths": [1.5, 2.5], "slopes": [10.0, 20.0]},
    {"first_step": 9, "error": null, "widths": [3.5], "slopes": [30.0]}]},
  {"contact": "event"}])");

TEST(TableOf, HasARowForEachObjectOfEachParent) {
  const Table table = TableOf(kAudits, "/contacts", "contact=^contact; first step; error:3; wrong in=why");
  EXPECT_EQ(table.ToCsv(),
            "contact,first step,error,wrong in\n"
            "lcp,7,0.123456789,\"a, b\"\n"
            "lcp,9,,\n");
  EXPECT_EQ(table.Display(0, 2), "0.123");
  EXPECT_EQ(TableOf(kAudits, "/contacts", "contact=^contact; error", 2, 1).rows().size(), 1u);
}

TEST(TableOf, ReachesIntoObjectsAndCountsLists) {
  EXPECT_EQ(TableOf(kAudits, "/found", "contact=^contact; step; exact; x=at/0; y=at/1").ToCsv(),
            "contact,step,exact,x,y\n"
            "lcp,3,yes,0.25,\n");
  EXPECT_EQ(TableOf(kAudits, "", "contact; contacts").ToCsv(), "contact,contacts\nlcp,2\nevent,\n");
}

TEST(CellOf, OfANumberThatIsNotFiniteIsEmpty) {
  EXPECT_EQ(CellOf(Json(std::numeric_limits<double>::quiet_NaN())).Exact(), "");
  EXPECT_EQ(CellOf(Json(0.5)).Exact(), "0.5");
}

TEST(JsonOutput, VectorsAreListsAndMatricesListsOfRows) {
  Eigen::MatrixXd matrix(2, 1);
  matrix << 1.5, 2.5;
  EXPECT_EQ(Json(matrix), Json::parse("[[1.5], [2.5]]"));
  EXPECT_EQ(Json(Eigen::Vector2d(1.5, 2.5)), Json::parse("[1.5, 2.5]"));
}

TEST(JsonText, HasNumbersThatAreReadBackAsTheSameBits) {
  for (int exponent = -300; exponent <= 300; ++exponent) {
    const double value = std::sin(exponent + 0.5) * std::pow(10.0, exponent);
    EXPECT_EQ(Json::parse(JsonText({{"x", value}}))["x"].get<double>(), value);
  }
  EXPECT_EQ(JsonText({1.0, -0.0, std::numeric_limits<double>::infinity()}), "[\n 1.0,\n -0.0,\n null\n]\n");
}

TEST(JsonText, HasAMarkForBytesThatAreNoText) { EXPECT_EQ(JsonText("bad \xff byte"), "\"bad \xEF\xBF\xBD byte\"\n"); }

TEST(TableOf, MakesARowOfEachElement) {
  EXPECT_EQ(TableOf(kAudits, "/contacts", "step=first_step; width=widths[]; slope=slopes[]").ToCsv(),
            "step,width,slope\n7,1.5,10\n7,2.5,20\n9,3.5,30\n");
}

}  // namespace
}  // namespace saltus
