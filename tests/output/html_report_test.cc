#include "output/html_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>
#include <set>

#include "base/file.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::Not;

Figure SmallFigure() {
  Figure figure;
  figure.title = "Curve";
  figure.panels.resize(1);
  figure.panels[0].x.label = "time (s)";
  figure.panels[0].y.label = "loss";
  figure.panels[0].series.push_back(Series::ForModel("lcp", {0, 1, 2}, {3, 1, 2}));
  return figure;
}

Table SmallTable() {
  Table table({{"contact"}, {"verdict"}});
  table.AddRow({"a < b", Cell("wrong").With(Tone::kBad)});
  return table;
}

HtmlReport FullReport() {
  HtmlReport report("Title & more", "sub<title>");
  report.AddTiles({{"12", "matched", Tone::kGood}, {"<3>", "failed & lost", Tone::kBad}});
  report.AddHeading(1, "Two balls");
  report.AddHeading(2, "Gradients");
  report.AddParagraph("The `exact_loss` is <b>not</b> bold; one ` alone stays.");
  report.AddList({"first & second", "`x < y`"});
  report.AddPreformatted("if (a < b) \"x\"");
  report.AddLinks({{"data", "results/a b.npz"}, {"paper", "https://example.org/?a=1&b=2"}});
  report.AddHeading(2, "Gradients");
  report.AddTable(SmallTable(), "Audits of `lcp`");
  report.AddTable(SmallTable(), "All of it", /*folded=*/true);
  EXPECT_TRUE(report.AddFigure(SmallFigure(), "A curve").ok());
  EXPECT_TRUE(report.AddFigure(SmallFigure(), "The curve again", /*folded=*/true).ok());
  return report;
}

std::vector<std::string> Matches(const std::string& text, const std::string& pattern) {
  const std::regex regex(pattern);
  std::vector<std::string> matches;
  for (std::sregex_iterator it(text.begin(), text.end(), regex), end; it != end; ++it) matches.push_back((*it)[1]);
  return matches;
}

TEST(HtmlReportTest, TextIsEscapedAndCodeIsMarked) {
  const std::string html = FullReport().Render();
  EXPECT_THAT(html, HasSubstr("<title>Title &amp; more</title>"));
  EXPECT_THAT(html, HasSubstr("<p class=\"subtitle\">sub&lt;title&gt;</p>"));
  EXPECT_THAT(html, HasSubstr("<p>The <code>exact_loss</code> is &lt;b&gt;not&lt;/b&gt; bold; one ` alone stays.</p>"));
  EXPECT_THAT(html, HasSubstr("<li><code>x &lt; y</code></li>"));
  EXPECT_THAT(html, HasSubstr("if (a &lt; b) &quot;x&quot;</pre>"));
  EXPECT_THAT(html, HasSubstr("<div class=\"tile bad\"><dt>failed &amp; lost</dt><dd>&lt;3&gt;</dd></div>"));
  EXPECT_THAT(html, HasSubstr("href=\"https://example.org/?a=1&amp;b=2\""));
}

TEST(HtmlReportTest, TablesAndFiguresAreNumberedAndCaptioned) {
  const std::string html = FullReport().Render();
  EXPECT_THAT(html, HasSubstr("<b>Table 1.</b> Audits of <code>lcp</code></figcaption>"));
  EXPECT_THAT(html, HasSubstr("<details><summary><b>Table 2.</b> All of it</summary>"));
  EXPECT_THAT(html, HasSubstr("<td data-label=\"verdict\" class=\"bad\">wrong</td>"));
  EXPECT_THAT(html, HasSubstr("<b>Figure 1.</b> A curve</figcaption>"));
  EXPECT_THAT(html, HasSubstr("<details><summary><b>Figure 2.</b> The curve again</summary>"));
}

TEST(HtmlReportTest, FiguresHaveATextAndPartsForNarrowScreens) {
  const std::string html = FullReport().Render();
  EXPECT_THAT(html, HasSubstr("aria-label=\"Curve. loss against time (s); lcp from (0, 3) to (2, 2).\""));
  EXPECT_EQ(Matches(html, "<use href=\"#(figure1-gnuplot_canvas)\"").size(), 2);  // the panel and its legend
  EXPECT_THAT(Matches(html, "\\sid=[\"'](figure1-gnuplot_canvas)[\"']"), testing::SizeIs(1));
}

TEST(HtmlReportTest, IdsAreUniqueAndContentsLeadThere) {
  const std::string html = FullReport().Render();
  std::set<std::string> ids;
  for (const std::string& id : Matches(html, "\\sid=[\"']([^\"']*)[\"']")) EXPECT_TRUE(ids.insert(id).second) << id;
  const std::string nav = html.substr(html.find("<nav"), html.find("</nav>") - html.find("<nav"));
  const std::vector<std::string> targets = Matches(nav, "href=\"#([^\"]*)\"");
  EXPECT_EQ(targets.size(), 3u);
  for (const std::string& target : targets) EXPECT_TRUE(ids.contains(target)) << target;
}

TEST(HtmlReportTest, NeedsNothingElseAndRunsNothing) {
  const std::string html = FullReport().Render();
  EXPECT_THAT(html, Not(HasSubstr("<script")));
  EXPECT_THAT(html, Not(HasSubstr("@import")));
  EXPECT_THAT(Matches(html, "(\\ssrc=)"), testing::IsEmpty());
  EXPECT_THAT(Matches(html, "(url\\((?!#))"), testing::IsEmpty());
}

TEST(HtmlReportTest, ElementsAreClosedInOrder) {
  const std::string html = FullReport().Render();
  const std::set<std::string> void_elements = {"meta", "link"};
  std::vector<std::string> open;
  const std::regex tag("<(/?)([A-Za-z0-9]+)((?:\"[^\"]*\"|'[^']*'|[^>\"'])*?)(/?)>");
  for (std::sregex_iterator it(html.begin(), html.end(), tag), end; it != end; ++it) {
    if ((*it)[1].length() > 0) {
      ASSERT_FALSE(open.empty());
      ASSERT_EQ(open.back(), (*it)[2]);
      open.pop_back();
    } else if ((*it)[4].length() == 0 && !void_elements.contains((*it)[2])) {
      open.push_back((*it)[2]);
    }
  }
  EXPECT_THAT(open, testing::IsEmpty());
}

TEST(HtmlReportTest, WritesTheFile) {
  const std::string path = testing::TempDir() + "report.html";
  ASSERT_TRUE(FullReport().Write(path).ok());
  EXPECT_EQ(*ReadFile(path), FullReport().Render());
  EXPECT_THAT(FullReport().Write("/no/such/report.html").message(), HasSubstr("/no/such/report.html"));
}

TEST(HtmlReportDeathTest, LinksLeadToFilesAndPagesOnly) {
  HtmlReport report("t", "");
  EXPECT_DEATH(report.AddLinks({{"x", "javascript:alert(1)"}}), "javascript");
}

}  // namespace
}  // namespace saltus
