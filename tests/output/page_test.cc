#include "output/page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>

#include "base/file.h"
#include "folders.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::ordered_json;

// The document that a page holds.
Json DocumentOf(const Page& page) {
  const std::string html = page.Render(), mark = "id=\"document\">";
  const size_t begin = html.find(mark) + mark.size();
  return Json::parse(html.substr(begin, html.find("</script>", begin) - begin));
}

TEST(PageTest, NeedsNothingElse) {
  const std::string html = Page("Title").Render();
  EXPECT_THAT(html, testing::StartsWith("<!DOCTYPE html>"));
  EXPECT_THAT(html, HasSubstr("<noscript>"));
  EXPECT_THAT(html, Not(HasSubstr("@import")));
  EXPECT_THAT(html, Not(HasSubstr("<!--")));
  EXPECT_FALSE(std::regex_search(html, std::regex("\\ssrc=|url\\((?!#)")));
  EXPECT_THAT(html, testing::EndsWith("</html>\n"));
}

TEST(PageTest, NothingInTheDocumentEndsIt) {
  Page page("</script><script>alert(1)</script> & more");
  page.AddParagraph("a < b \"c\" \\ \xff");  // the last is no UTF-8
  const std::string html = page.Render();
  EXPECT_THAT(html, Not(HasSubstr("alert(1)</script>")));
  const Json document = DocumentOf(page);
  EXPECT_EQ(document["title"], "</script><script>alert(1)</script> & more");
  EXPECT_EQ(document["parts"][0]["text"], "a < b \"c\" \\ \uFFFD");
}

TEST(PageTest, TablesHaveWhatATerminalShows) {
  Table table({{"contact"}, {"empty"}, {"loss", 3}, {"verdict"}});
  table.AddRow({"lcp", Cell(), 1.23456, Cell("wrong").WithTone(Tone::kBad)});
  Page page("t");
  page.AddTable(table, "caption", {"a note"}, /*folded=*/true);
  const Json part = DocumentOf(page)["parts"][0];
  EXPECT_EQ(part["kind"], "table");
  EXPECT_EQ(part["folded"], true);
  EXPECT_EQ(part["notes"][0], "a note");
  EXPECT_EQ(part["table"]["keys"], 1);
  EXPECT_EQ(part["table"]["columns"].size(), 3u);
  EXPECT_EQ(part["table"]["columns"][1], Json({{"header", "loss"}, {"number", true}}));
  EXPECT_EQ(part["table"]["rows"][0], Json::parse(R"(["lcp", "1.23", ["wrong", "bad"]])"));
}

TEST(PageTest, PartsStandInTheirOrder) {
  Page page("t", "s");
  page.AddHeading("h");
  page.AddList({"one", "two"});
  page.AddMoments({{"plain", "", 0}, {"timed", "lcp", 0.5}});
  page.AddTiles({{"3", "of them", Tone::kGood}});
  page.AddLinks({"a.npz"});
  page.AddPlot("controls", "c");
  page.AddStyle("run", "#123456", Dash::kDotted);
  const Json document = DocumentOf(page);
  EXPECT_EQ(document["subtitle"], "s");
  std::vector<std::string> kinds;
  for (const Json& part : document["parts"]) kinds.push_back(part["kind"]);
  EXPECT_THAT(kinds, testing::ElementsAre("heading", "list", "list", "tiles", "links", "plot"));
  EXPECT_FALSE(document["parts"][2]["items"][0].contains("time"));
  EXPECT_EQ(document["parts"][2]["items"][1]["time"], 0.5);
  EXPECT_EQ(document["styles"][0]["dash"], "dotted");
}

TEST(PageTest, LongListsOfResultsAreThinned) {
  Json results = {{"short", Json::array({1, 2})}, {"long", Json::array()}, {"deep", Json::array()}};
  for (int i = 0; i <= 2000; ++i) results["long"].push_back(i);
  results["deep"].push_back({{"list", results["long"]}});
  Page page("t");
  page.SetResults(results);
  const Json thinned = DocumentOf(page)["results"];
  EXPECT_EQ(thinned["short"], results["short"]);
  for (const Json& list : {thinned["long"], thinned["deep"][0]["list"]}) {
    EXPECT_EQ(list["every"], 3);
    EXPECT_EQ(list["items"].size(), 667u);
    EXPECT_EQ(list["items"][666], 1998);
  }
}

TEST(PageTest, WritesTheFile) {
  const std::string path = TempFile("page_test.html");
  EXPECT_TRUE(Page("t").Write(path).ok());
  EXPECT_EQ(*ReadFile(path), Page("t").Render());
  EXPECT_THAT(Page("t").Write("/no/such/page.html").message(), HasSubstr("/no/such/page.html"));
}

}  // namespace
}  // namespace saltus
