"""Constellation figures: lines between stars. The figures are common knowledge. They are stated with the star names of
the GSS star table.

A line is a sequence of stars, each connected to the next. A star is identified by its proper name or by its letter in
the row's constellation.
"""

from __future__ import annotations

from dataclasses import dataclass

from gss.domain.errors import CorruptData
from gss.domain.stars import StarTable

FAINTEST_JOINED_MAG = 5.0
"""Faintest magnitude of a star on a line."""
# Format: abbreviation, name, then lines separated by ";" with stars separated by commas.
TABLE = """
And Andromeda: Alpheratz,δ,Mirach,Almach; Mirach,μ,ν
Aqr Aquarius: Albali,Sadalsuud,Sadalmelik,Sadachbia,Sadaltager,η; Sadalmelik,Ancha,Hydor,τ²,Skat
Aql Aquila: Tarazed,Altair,Alshain,θ; Altair,Almizan,Okab; Almizan,Al Thalimain Prior
Ari Aries: Hamal,Sheratan,Mesarthim
Aur Auriga: Capella,Menkalinan,Mahasim,Elnath,Hassaleh,Almaaz,Capella
Boo Boötes: Arcturus,Izar,Thiba,Nekkar,Seginus,ρ,Arcturus,Muphrid; Arcturus,ζ
Cnc Cancer: Zubanah,Asellus Borealis,Asellus Australis,Acubens; Asellus Australis,Tarf
CVn Canes Venatici: Cor Caroli,Chara
CMa Canis Major: Mirzam,Sirius,Wezen,Aludra; Wezen,Adhara
CMi Canis Minor: Procyon,Gomeisa
Cap Capricornus: Algedi,Dabih,θ,ι,Nashira,Deneb Algedi,Yen,ω,Dabih
Car Carina: Canopus,Avior,Aspidiske,υ,Miaplacidus,ω,θ
Cas Cassiopeia: Caph,Shedar,Navi,Ruchbah,Segin
Cen Centaurus: Rigil Kentaurus,Hadar,ε,Muhlifain,δ; ε,ν,Menkent; ν,η
Cep Cepheus: Alderamin,Alfirk,Errai,ι,δ,ζ,Alderamin; Alfirk,ι
Cet Cetus: Menkar,Kaffaljidhma,δ,Baten Kaitos,Al Naymat,Dheneb,Deneb Kaitos Shemali,Diphda; Baten Kaitos,τ,Diphda
Col Columba: ε,Phact,Wazn,γ
CrB Corona Borealis: θ,Nusakan,Alphecca,γ,δ,ε
Crv Corvus: Gienah,Algorab,Kraz,Minkar,Gienah; Minkar,Alchiba
Cru Crux: Acrux,Gacrux; Mimosa,Imai
Cyg Cygnus: Deneb,Sadr,η,Albireo; Fawaris,Sadr,Aljanah,ζ
Del Delphinus: Aldulfin,Rotanev,Sualocin,Al Salib,Al Ukud,Rotanev
Dra Draco: Rastaban,Eltanin,Grumium,Altais,Aldhibah,Athebyne,θ,Edasich,Thuban,κ,Giausar
Eri Eridanus: Cursa,μ,ν,Beid,Zaurak,Rana,Ran,Azha; κ,φ,χ,Achernar
Gem Gemini: Castor,τ,Mebsuta,Tejat,Propus; Pollux,Wasat,Mekbuda,Alhena; Castor,Pollux
Gru Grus: Aldhanab,λ,δ¹,Tiaki,ε,ζ; δ¹,Alnair
Her Hercules: η,Rutilicus,ε,π,η; Rutilicus,Kornephoros,γ; ε,Sarin,Rasalgethi
Hya Hydra: Ashlesha,ζ,θ,Alphard,λ,μ,ν,ξ,β,γ,π
Leo Leo: Regulus,Al Jabhah,Algieba,Adhafera,Rasalas,Algenubi; Algieba,Zosma,Denebola,Chertan,Regulus; Zosma,Chertan
Lep Lepus: Arneb,Nihal,Kursi al Jabbar,Arsh al Jauzah,Arneb,μ,ε,Nihal; Arneb,ζ,η
Lib Libra: Brachium,Zubenelgenubi,Zubeneschamali,Zubenelhakrabi,Zubenelgenubi
Lup Lupus: ζ,Men,KeKouan,δ,γ,η
Lyr Lyra: Vega,δ²,Sulafat,Sheliak,Vega
Oph Ophiuchus: Rasalhague,Cebalrai,Sabik,Saik,Yed Posterior,Yed Prior,κ,Rasalhague
Ori Orion: Meissa,Betelgeuse,Alnitak,Saiph,Rigel,Mintaka,Bellatrix,Meissa; Alnitak,Alnilam,Mintaka; Betelgeuse,Bellatrix
Pav Pavo: Peacock,γ,β,δ,Peacock
Peg Pegasus: Markab,Scheat,Alpheratz,Algenib,Markab,Homam,Biham,Enif; Scheat,Matar
Per Perseus: Miram,γ,Mirfak,δ,ε,Menkib,ζ; Mirfak,Algol,Gorgonea Tertia
Phe Phoenix: Ankaa,β,γ,δ
Psc Pisces: Alpherg,Torcular,Alrescha,ν,ε,ω,ι,θ,γ,λ,ι
PsA Piscis Austrinus: γ,δ,Fomalhaut,ε,μ
Pup Puppis: Naos,π,σ,τ,ν,π; Naos,Tureis
Sge Sagitta: γ,δ,Sham; δ,β
Sgr Sagittarius: Alnasl,Kaus Media,Kaus Australis,Alnasl; Kaus Media,Kaus Borealis,Namalsadirah,Kaus Media; Namalsadirah,Nunki,τ,Ascella,Namalsadirah; Ascella,Kaus Australis
Sco Scorpius: Acrab,Dschubba,Fang; Dschubba,Antares,Paikauhale,Larawag,Xamidimura,η,Sargas,Mula,Shaula,Lesath
Tau Taurus: Tianguan,Aldebaran,θ¹,Prima Hyadum,Secunda Hyadum,Ain,Elnath; Prima Hyadum,λ,ο
TrA Triangulum Australe: Atria,β,γ,Atria
Tri Triangulum: Mothallah,Mizan,γ,Mothallah
UMa Ursa Major: Alkaid,Mizar,Alioth,Megrez,Dubhe,Merak,Phecda,Megrez; Phecda,Taiyangshou,ψ
UMi Ursa Minor: Polaris,Yildun,Circitores,Akfa Farkadain,Kochab,Pherkad
Vel Vela: Regor,Alsephina,Markeb,Suhail,Regor
Vir Virgo: Heze,Spica,Porrima,Minelauva,Vindemiatrix; Porrima,Zaniah,Zavijava
"""  # noqa: E501 - one line a constellation


@dataclass(frozen=True)
class Figure:
    """A constellation. ``lines``: sequences of Hipparcos numbers, each connected to the next."""

    short: str
    name: str
    lines: tuple[tuple[int, ...], ...]


def figures(stars: StarTable) -> tuple[Figure, ...]:
    """Return the figures for the stars of a table. Raises CorruptData if the table lacks a star of a line. If two stars
    have the same name, the brighter star is used."""
    by_name: dict[str, int] = {}
    for hip in stars.hip[stars.v_mag.argsort(kind="stable")]:
        name = stars.names.get(int(hip))
        if name is not None:
            by_name.setdefault(name, int(hip))
    return tuple(_figure(row, by_name) for row in TABLE.strip().splitlines())


def _figure(row: str, by_name: dict[str, int]) -> Figure:
    head, lines = row.split(": ")
    short, name = head.split(" ", 1)

    def star(word: str) -> int:
        row = by_name.get(f"{word} {short}") or by_name.get(word)
        if row is None:
            raise CorruptData(
                "a constellation line uses a star that is not in the table", expected=f"{word} {short}", got=name
            )
        return row

    return Figure(
        short, name, tuple(tuple(star(word.strip()) for word in line.split(",")) for line in lines.split(";"))
    )
