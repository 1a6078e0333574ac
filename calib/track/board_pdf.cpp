#include "calib/track/board_pdf.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <utility>
#include <vector>

#include "calib/track/internal/board_layout.h"

namespace penumbra::calib {

namespace {

constexpr double kPoint_mm = 25.4 / 72;
// Around the board: what printers leave white, two lines of text above, ruler and text below.
constexpr double kBorder_mm = 5, kAbove_mm = 6, kBelow_mm = 12;
constexpr double kRuler_mm = 100;

struct Page {
  double width_mm, height_mm;
};

Page page_of(Paper paper) {
  return paper == Paper::kA4 ? Page{210, 297} : Page{215.9, 279.4};
}

std::string_view paper_name(Paper paper) {
  return paper == Paper::kA4 ? "A4" : "Letter";
}

std::string escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '(' || c == ')' || c == '\\') out += '\\';
    out += c;
  }
  return out;
}

// In millimetres from the lower left corner of the page.
class PdfDrawing {
 public:
  void rectangle(double x, double y, double width, double height) {
    fmt::format_to(std::back_inserter(path_), "{:.4f} {:.4f} {:.4f} {:.4f} re\n", x, y, width,
                   height);
  }
  // One path, so that where rectangles touch no seam is left.
  void fill() { text_ += std::exchange(path_, {}) + "f\n"; }
  void write(double x, double y, double height, std::string_view words) {
    fmt::format_to(std::back_inserter(text_), "BT /F1 {:.2f} Tf {:.3f} {:.3f} Td ({}) Tj ET\n",
                   height, x, y, escaped(words));
  }
  std::string stream() const {
    return fmt::format("q\n{0:.9f} 0 0 {0:.9f} 0 0 cm\n0 g\n{1}Q\n", 1 / kPoint_mm, text_);
  }

 private:
  std::string path_, text_;
};

void draw_ruler(double x, double y, PdfDrawing& out) {
  constexpr double kThin = .2, kTick = 2, kLongTick = 4;
  out.rectangle(x, y, kRuler_mm, kThin);
  for (int i = 0; i <= 10; ++i) {
    const bool end = i == 0 || i == 10;
    // The ends of the ruler are the outer edges of the outer ticks.
    const double at = x + i * kRuler_mm / 10 - (i == 10 ? kThin : i == 0 ? 0 : kThin / 2);
    out.rectangle(at, y, kThin, end ? kLongTick : kTick);
  }
  out.fill();
}

// Objects of a file one after the other, with the table of where they begin.
std::string pdf_of(const std::vector<std::string>& objects) {
  std::string out = "%PDF-1.4\n";
  std::vector<std::size_t> starts;
  for (std::size_t i = 0; i < objects.size(); ++i) {
    starts.push_back(out.size());
    out += fmt::format("{} 0 obj\n{}\nendobj\n", i + 1, objects[i]);
  }
  const std::size_t table = out.size();
  out += fmt::format("xref\n0 {}\n0000000000 65535 f \n", objects.size() + 1);
  for (const std::size_t start : starts) out += fmt::format("{:010} 00000 n \n", start);
  out += fmt::format("trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{}\n%%EOF\n",
                     objects.size() + 1, table);
  return out;
}

}  // namespace

Result<Paper> parse_paper(std::string_view name) {
  if (name == "a4") return Paper::kA4;
  if (name == "letter") return Paper::kLetter;
  return fail(ErrorCode::kInvalid, "paper \"" + std::string(name) + "\"",
              "is neither a4 nor letter");
}

std::string board_text(const Board& board) {
  const std::string counts = fmt::format("{}x{}:{}", board.columns, board.rows, board.square_m);
  if (board.kind == Board::Kind::kChessboard) return "chessboard:" + counts;
  return fmt::format("{}:{}:{}{}", board.kind == Board::Kind::kCharuco ? "charuco" : "apriltag",
                     counts, board.marker_m,
                     board.first_id > 0 ? fmt::format(":{}", board.first_id) : "");
}

Result<std::string> board_pdf(const Board& board, Paper paper) {
  const BoardLayout layout = layout_of(board);
  const double width = 1000 * layout.outline.size_m.x, height = 1000 * layout.outline.size_m.y;
  Page page = page_of(paper);
  const auto fits = [&](const Page& p) {
    return width <= p.width_mm - 2 * kBorder_mm &&
           height <= p.height_mm - 2 * kBorder_mm - kAbove_mm - kBelow_mm;
  };
  if (width > height) std::swap(page.width_mm, page.height_mm);
  if (!fits(page)) std::swap(page.width_mm, page.height_mm);
  if (!fits(page))
    return fail(ErrorCode::kInvalid, "board \"" + board_text(board) + "\"",
                fmt::format("is {:.0f} x {:.0f} mm large and does not fit {}, {:.0f} x {:.0f} mm, "
                            "with its ruler: take smaller squares or fewer",
                            width, height, paper_name(paper), page_of(paper).width_mm,
                            page_of(paper).height_mm));
  PdfDrawing drawing;
  const double left = (page.width_mm - width) / 2,
               free = page.height_mm - 2 * kBorder_mm - kAbove_mm - kBelow_mm - height,
               top = page.height_mm - kBorder_mm - kAbove_mm - free / 2;
  for (const BoardLayout::Rectangle& r : black_of(layout)) {
    const glm::dvec2 at = 1000. * (r.at_m - layout.outline.at_m), size = 1000. * r.size_m;
    drawing.rectangle(left + at.x, top - at.y - size.y, size.x, size.y);
  }
  drawing.fill();
  const double ruler = top - height - kBelow_mm + 4, text_mm = 3.2;
  drawing.write(left, top + 2, text_mm, "--board " + board_text(board));
  draw_ruler(left, ruler, drawing);
  // Beside the ruler where there is room, else below it.
  const char* const how = "Print at 100 %, not fitted to the page. The ruler is 100.0 mm long;";
  const char* const else_how = "if yours is not, multiply the lengths in --board by its mm / 100.";
  const bool beside = left + kRuler_mm + 100 < page.width_mm;
  const double x = beside ? left + kRuler_mm + 5 : left;
  drawing.write(x, beside ? ruler + 1.5 : ruler - 3.5, 2.6, how);
  drawing.write(x, beside ? ruler - 2 : ruler - 7, 2.6, else_how);
  const std::string stream = drawing.stream();
  return pdf_of({"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
                 "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
                 fmt::format("<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {:.4f} {:.4f}] /Contents "
                             "4 0 R /Resources << /Font << /F1 5 0 R >> >> >>",
                             page.width_mm / kPoint_mm, page.height_mm / kPoint_mm),
                 fmt::format("<< /Length {} >>\nstream\n{}endstream", stream.size(), stream),
                 "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"});
}

}  // namespace penumbra::calib
