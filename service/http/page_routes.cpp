#include <span>

#include "service/http/internal/context.h"
#include "service/http/internal/page_files.h"

namespace penumbra::service {

// Nothing from elsewhere, nothing inline, in nobody's frame.
void add_page_routes(httplib::Server& server) {
  for (const PageFile& file : std::span(kPageFiles, kPageFileCount))
    server.Get(std::string(file.path), [&file](const httplib::Request&, httplib::Response& r) {
      r.set_header("Content-Security-Policy",
                   "default-src 'none'; script-src 'self'; style-src 'self'; "
                   "img-src 'self' blob:; connect-src 'self'; base-uri 'none'; "
                   "form-action 'none'; frame-ancestors 'none'");
      r.set_header("X-Content-Type-Options", "nosniff");
      r.set_header("Cache-Control", "no-cache");
      r.set_content(file.text.data(), file.text.size(), std::string(file.type));
    });
}

}  // namespace penumbra::service
