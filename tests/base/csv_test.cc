#include "base/csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>

#include "folders.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(CsvTest, ReadsQuotesLineEndsAndMissingLastNewline) {
  const StatusOr<CsvDocument> read = ParseCsv("a,b\r\n\"x,\"\"y\"\"\",\r\n\n ,\"\"");
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_THAT(read->rows, ElementsAre(ElementsAre("x,\"y\"", ""), ElementsAre(" ", "")));
  EXPECT_EQ(read->Find("b"), 1u);
  EXPECT_EQ(read->Find("c"), std::nullopt);
}

TEST(CsvTest, ErrorsNameTheLine) {
  const auto message = [](std::string_view text) { return ParseCsv(text).status().message(); };
  EXPECT_EQ(message("a,b\n\"two\nlines\",1\n1\n"), "line 4: 1 fields, the header has 2");
  EXPECT_EQ(message("a,b\r\n1,2\r\n3"), "line 3: 1 fields, the header has 2");
  EXPECT_EQ(message("a,b\n1,\"2\n"), "line 2: quote is never closed");
  EXPECT_EQ(message("a,b\n1,\"2\"3\n"), "line 2: text after a closing quote");
  EXPECT_EQ(message("a,b\n1,2\"\n"), "line 2: quote inside an unquoted field");
  EXPECT_EQ(message("\n\n"), "found nothing, expected a line with the names of columns");
}

TEST(CsvTest, ReadsThePublishedValues) {
  const StatusOr<CsvDocument> read = ReadCsv(SourceFolder() + "/data/published.csv");
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_THAT(read->header,
              ElementsAre("table",
                          "problem",
                          "friction",
                          "contact",
                          "precision",
                          "quantity",
                          "published",
                          "expected",
                          "tolerance",
                          "verdict",
                          "note"));
  EXPECT_THAT(
      read->rows.front(),
      ElementsAre("T1", "bounce_once", "0", "lcp", "double", "dloss/dp_y", "-1.0000", "-1.0", "5e-5", "match", ""));
  EXPECT_EQ(read->rows.back().back(), "grid value, and only a local optimum");
}

TEST(CsvTest, MissingFileIsAnError) {
  EXPECT_THAT(ReadCsv("/no/such.csv").status().message(), HasSubstr("/no/such.csv"));
}

}  // namespace
}  // namespace saltus
